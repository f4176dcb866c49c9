// A cursor is an instant that plots, planes, animations and checklists of one group share.

class Cursor {
  constructor(name) {
    this.name = name;
    this.low = Infinity;
    this.high = -Infinity;
    this.time = null;
    this.followers = [];
    this.due = false;
    this.playing = false;
    this.speed = 1;
    this.animated = false; // whether there is something to play
    this.log = false;
  }

  /** Widen the span that the cursor may be moved over. */
  reach(low, high) {
    this.low = Math.min(this.low, low);
    this.high = Math.max(this.high, high);
    if (this.time === null) this.time = this.low;
  }

  /** Call `follow(time)` whenever the cursor has moved, and now. */
  listen(follow) {
    this.followers.push(follow);
    if (this.time !== null) follow(this.time);
  }

  /** Move to an instant; everybody hears of it with the next frame. */
  move(time) {
    if (!(this.high >= this.low)) return;
    this.time = Math.min(Math.max(time, this.low), this.high);
    Cursor.active = this;
    if (this.due) return;
    this.due = true;
    requestAnimationFrame(() => {
      this.due = false;
      for (const follow of this.followers) follow(this.time);
    });
  }

  step(parts) {
    this.pause();
    this.move(this.log ? this.time * (this.high / this.low) ** parts : this.time + parts * (this.high - this.low));
  }

  pause() {
    this.playing = false;
    for (const follow of this.followers) follow(this.time);
  }

  /** Play from here, from the beginning where it has ended; the motion begins again at its end. */
  play() {
    this.playing = true;
    Cursor.active = this;
    if (this.time >= this.high) this.time = this.low;
    let before = null;
    const frame = (now) => {
      if (!this.playing) return;
      if (before !== null) {
        const next = this.time + (this.speed * (now - before)) / 1000;
        this.move(next > this.high ? this.low : next);
      }
      before = now;
      requestAnimationFrame(frame);
    };
    requestAnimationFrame(frame);
  }

  toggle() {
    if (!this.animated) return;
    if (this.playing) this.pause();
    else this.play();
  }
}
Cursor.active = null;
Cursor.all = new Map();

/** Return the cursor of a group. */
function cursorOf(group) {
  if (!Cursor.all.has(group)) Cursor.all.set(group, new Cursor(group));
  return Cursor.all.get(group);
}

/** Return where a block shows an instant: of a motion that repeats, within its first period. */
function within(block, time) {
  if (!block.period) return time;
  const folded = time % block.period;
  return folded < 1e-9 * block.period && time > 0 ? (time >= block.period ? block.period : folded) : folded;
}
