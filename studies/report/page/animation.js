// A mechanism in motion on a canvas: flat in its plane, or in space, turned by dragging.

const ARC = 24; // pixels
const SWEEP = (3 * Math.PI) / 4; // of the arc at the limit

/** Return where an instant lies among times: the frame before it and the share of the way to the next. */
function frameAt(times, time) {
  let [low, high] = [0, times.length - 1];
  if (time >= times[high]) return { at: high, share: 0 };
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= time) low = middle;
    else high = middle;
  }
  const span = times[high] - times[low];
  return { at: low, share: span > 0 ? Math.max(0, (time - times[low]) / span) : 0 };
}

/** Return a value, or a row of values, between two frames. */
function mixed(rows, frame) {
  const one = rows[frame.at];
  const other = rows[Math.min(frame.at + 1, rows.length - 1)];
  if (!Array.isArray(one)) return one + frame.share * (other - one);
  return one.map((x, k) => x + frame.share * (other[k] - x));
}

/** Return flat points of some dimension as triples. */
function triples(row, dimension) {
  const found = [];
  for (let k = 0; k + dimension <= row.length; k += dimension) found.push([row[k], row[k + 1], dimension === 3 ? row[k + 2] : 0]);
  return found;
}

/** A view: from the mechanism's metres to the canvas's pixels, about the middle of all that is drawn. */
class View {
  constructor(block) {
    this.flat = block.dimension === 2;
    this.yaw = -0.7;
    this.pitch = 0.35;
    const low = [Infinity, Infinity, Infinity];
    const high = [-Infinity, -Infinity, -Infinity];
    const rows = [block.bodies, ...block.ghosts.map((ghost) => ghost.bodies)].flat().flatMap((body) => body.points);
    for (const row of [...rows, ...block.paths.map((path) => path[1].flat())]) {
      for (const point of triples(row, block.dimension)) {
        point.forEach((x, k) => {
          low[k] = Math.min(low[k], x);
          high[k] = Math.max(high[k], x);
        });
      }
    }
    this.middle = low.map((x, k) => (Number.isFinite(x) ? (x + high[k]) / 2 : 0));
    this.size = low.map((x, k) => (Number.isFinite(x) ? high[k] - x : 0));
  }

  /** Fit everything into a canvas of some width and height [px]. */
  fit(width, height) {
    this.centre = [width / 2, height / 2];
    const room = [width - 2 * ARC - 24, height - 2 * ARC - 24].map((x) => Math.max(x, 60));
    const wide = this.flat ? this.size : [Math.hypot(this.size[0], this.size[1]), Math.hypot(...this.size), 0];
    this.scale = Math.min(room[0] / Math.max(wide[0], 1e-9), room[1] / Math.max(wide[1], 1e-9));
    if (!(Math.max(wide[0], wide[1]) > 1e-9)) this.scale = 100;
  }

  /** Return a direction [m] as the canvas shows it, in pixels to the right and down. */
  turned([x, y, z]) {
    if (this.flat) return [x * this.scale, -y * this.scale];
    const [c, s] = [Math.cos(this.yaw), Math.sin(this.yaw)];
    const [right, away] = [c * x + s * y, -s * x + c * y];
    const up = Math.cos(this.pitch) * z + Math.sin(this.pitch) * away;
    return [right * this.scale, -up * this.scale];
  }

  /** Return the pixel of a place [m]. */
  at(point) {
    const [x, y] = this.turned(point.map((value, k) => value - this.middle[k]));
    return [this.centre[0] + x, this.centre[1] + y];
  }
}

function drawBody(ctx, view, body, frame, dimension, colour, width) {
  const at = triples(mixed(body.points, frame), dimension).map((point) => view.at(point));
  ctx.strokeStyle = ctx.fillStyle = colour;
  ctx.lineWidth = width;
  if (body.fixed) {
    for (const [x, y] of at) {
      ctx.beginPath();
      ctx.moveTo(x, y);
      ctx.lineTo(x - 7, y + 11);
      ctx.lineTo(x + 7, y + 11);
      ctx.closePath();
      ctx.fill();
    }
    return;
  }
  ctx.beginPath();
  for (const point of at) ctx.lineTo(...point);
  if (at.length > 2) ctx.closePath();
  ctx.stroke();
  for (const [x, y] of at) {
    ctx.beginPath();
    ctx.arc(x, y, width * 0.9 + 1, 0, 2 * Math.PI);
    ctx.fill();
  }
}

/** Return two directions [m] across an axis, of unit length, the first of them upwards as far as can be. */
function across(axis) {
  const up = Math.abs(axis[2]) < 0.9 ? [0, 0, 1] : [0, 1, 0];
  const along = up[0] * axis[0] + up[1] * axis[1] + up[2] * axis[2];
  const first = up.map((x, k) => x - along * axis[k]);
  const size = Math.hypot(...first);
  const e = first.map((x) => x / size);
  return [e, [axis[1] * e[2] - axis[2] * e[1], axis[2] * e[0] - axis[0] * e[2], axis[0] * e[1] - axis[1] * e[0]]];
}

function drawArc(ctx, view, at, axis, from, to) {
  const [e, f] = across(axis);
  const radius = ARC / view.scale;
  const [x, y] = view.at(at);
  ctx.beginPath();
  for (let k = 0; k <= 24; k += 1) {
    const angle = from + ((to - from) * k) / 24;
    const [dx, dy] = view.turned(e.map((value, i) => radius * (Math.cos(angle) * value + Math.sin(angle) * f[i])));
    ctx.lineTo(x + dx, y + dy);
  }
  ctx.stroke();
}

/** Return an effort's share of its limit, of its peak where it has none, signed, and whether it is at the limit. */
function shareOf(drive, effort) {
  const limits = drive.limits.map((limit) => (limit === null ? null : Math.abs(limit)));
  const full = Math.max(...limits.map((limit) => limit || 0)) || Math.max(...drive.effort.map(Math.abs)) || 1;
  const limit = effort < 0 ? limits[0] : limits[1];
  return { share: effort / full, ends: [-(limits[0] ?? 0) / full, (limits[1] ?? 0) / full], full: limit !== null && Math.abs(effort) >= 0.999 * limit };
}

/** Draw an actuator's effort: an arc about a hinge, an arrow along a slide or a force, its limits behind it in grey; a tendon as a line. */
function drawDrive(ctx, view, drive, frame, dimension) {
  const { share, ends, full } = shareOf(drive, mixed(drive.effort, frame));
  const colour = theme.colour(full ? "bad" : "effort");
  for (const mark of drive.marks) {
    if (mark.shape === "line") drawLine(ctx, view, triples(mixed(mark.at, frame), dimension), Math.abs(share), colour);
    else drawLoad(ctx, view, mark, frame, dimension, share, ends, colour);
  }
}

/** Draw a tendon: a thin line, in the load's colour and thicker the more it pulls or pushes. */
function drawLine(ctx, view, points, share, colour) {
  const slack = share < 0.02;
  ctx.strokeStyle = slack ? theme.colour("faint") : colour;
  ctx.lineWidth = slack ? 2 : 1.5 + 3.5 * Math.min(share, 1);
  ctx.beginPath();
  for (const point of points) ctx.lineTo(...view.at(point));
  ctx.stroke();
}

function drawLoad(ctx, view, mark, frame, dimension, share, ends, colour) {
  const place = mixed(mark.at, frame);
  const at = [place[0], place[1], dimension === 3 ? place[2] : 0];
  const row = mixed(mark.axis, frame);
  const turns = mark.shape === "arc";
  const axis = dimension === 3 ? row : turns ? [0, 0, row[0]] : [row[0], row[1], 0];
  const [x, y] = view.at(at);
  const straight = () => view.turned(axis.map((value) => (2 * ARC * value) / view.scale));
  for (const [part, look] of [[ends, theme.colour("faint")], [[0, share], colour]]) {
    ctx.strokeStyle = ctx.fillStyle = look;
    ctx.lineWidth = 5;
    if (turns) {
      drawArc(ctx, view, at, axis, part[0] * SWEEP, part[1] * SWEEP);
    } else {
      const [dx, dy] = straight();
      ctx.beginPath();
      ctx.moveTo(x + part[0] * dx, y + part[0] * dy);
      ctx.lineTo(x + part[1] * dx, y + part[1] * dy);
      ctx.stroke();
    }
  }
  if (Math.abs(share) < 0.02) return;
  const tip = (k) => {
    if (!turns) {
      const [dx, dy] = straight();
      return [x + k * dx, y + k * dy];
    }
    const [e, f] = across(axis);
    const [dx, dy] = view.turned(e.map((v, i) => (ARC / view.scale) * (Math.cos(k * SWEEP) * v + Math.sin(k * SWEEP) * f[i])));
    return [x + dx, y + dy];
  };
  const [end, before] = [tip(share), tip(share - 0.05 * Math.sign(share))];
  const way = Math.atan2(end[1] - before[1], end[0] - before[0]);
  ctx.beginPath();
  ctx.moveTo(end[0] + 9 * Math.cos(way), end[1] + 9 * Math.sin(way));
  for (const side of [2.3, -2.3]) ctx.lineTo(end[0] + 7 * Math.cos(way + side), end[1] + 7 * Math.sin(way + side));
  ctx.closePath();
  ctx.fill();
}

/** Write names beside their places, below one another where places fall together. */
function drawNames(ctx, view, block, frame) {
  ctx.font = "12px system-ui, sans-serif";
  const taken = [];
  for (const [name, places] of block.labels) {
    const place = mixed(places, frame);
    let [x, y] = view.at([place[0], place[1], block.dimension === 3 ? place[2] : 0]);
    [x, y] = [x + 9, y - 9];
    const width = ctx.measureText(name).width;
    if (x + width > ctx.canvas.clientWidth - 4) x -= width + 18; // to the left of its place, at the right edge
    while (taken.some(([a, b, w]) => Math.abs(b - y) < 13 && x < a + w + 4 && a < x + width + 4)) y += 13;
    taken.push([x, y, width]);
    ctx.lineWidth = 3;
    ctx.strokeStyle = theme.colour("paper");
    ctx.strokeText(name, x, y);
    ctx.fillStyle = theme.colour("ink");
    ctx.fillText(name, x, y);
  }
}

/** Return what drives are drawn: the ghost's, of the effort that acted as it was tracked, where one is shown. */
function drivesShown(block, shown) {
  const ghost = block.ghosts.find((one) => one.name === shown.ghost);
  return ghost && ghost.drives.length ? ghost.drives : block.drives;
}

/** Draw one frame of an animation on a canvas of width and height [px]. */
function drawFrame(ctx, view, block, time, shown) {
  const frame = frameAt(block.times, within(block, time));
  for (const [index, [, places]] of block.paths.entries()) {
    ctx.strokeStyle = theme.series(index + 3);
    ctx.lineWidth = 1.2;
    ctx.beginPath();
    for (const place of places) ctx.lineTo(...view.at([place[0], place[1], block.dimension === 3 ? place[2] : 0]));
    ctx.stroke();
  }
  const moving = block.bodies.filter((body) => !body.fixed);
  for (const body of [...moving].reverse()) drawBody(ctx, view, body, frame, block.dimension, theme.series(moving.indexOf(body)), 4);
  for (const body of block.bodies) if (body.fixed) drawBody(ctx, view, body, frame, block.dimension, theme.colour("fixed"), 4);
  const ghost = block.ghosts.find((one) => one.name === shown.ghost);
  if (ghost) {
    ctx.globalAlpha = 0.9;
    ctx.setLineDash([5, 4]);
    for (const body of ghost.bodies) if (!body.fixed) drawBody(ctx, view, body, frame, block.dimension, theme.colour("ghost"), 2);
    ctx.setLineDash([]);
    ctx.globalAlpha = 1;
  }
  for (const drive of drivesShown(block, shown)) drawDrive(ctx, view, drive, frame, block.dimension);
  if (shown.names) drawNames(ctx, view, block, frame);
}
