// The animation's canvas with what plays it: play and pause, the instant, the speed, names, the ghost.

const SPEEDS = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2];
const MOST_NAMES = 16; // more names of pins are written on demand
const SHOWN_S = 4; // a motion is shown in about as many seconds

/** Return the figure of an animation. */
function showAnimation(block) {
  colourBodies(block.bodies);
  const cursor = cursorOf(block.group);
  cursor.reach(block.times[0], block.times.at(-1));
  cursor.animated = true;
  const wanted = (cursor.high - cursor.low) / SHOWN_S;
  const timed = block.unit === "s";
  cursor.speed = wanted;
  if (timed) cursor.speed = SPEEDS.reduce((best, one) => (Math.abs(Math.log(one / wanted)) < Math.abs(Math.log(best / wanted)) ? one : best));
  const shown = { names: block.labels.length <= MOST_NAMES, ghost: block.ghosts.length ? block.ghosts[0].name : "" };
  const canvas = make("canvas", { class: "stage", role: "img", "aria-label": `${block.title}, drawn in motion` });
  const button = make("button", { type: "button", class: "play", onclick: () => cursor.toggle() }, "Play");
  const bar = make("input", { type: "range", min: 0, max: 1000, value: 0, "aria-label": "instant of the motion" });
  bar.addEventListener("input", () => {
    const asked = cursor.low + (bar.value / 1000) * (cursor.high - cursor.low);
    cursor.pause(); // which puts the bar where the cursor still is
    cursor.move(asked);
  });
  const clock = make("output", { class: "clock" });
  const efforts = make("p", { class: "efforts" });
  const speed = make("select", { "aria-label": "speed", onchange: (event) => (cursor.speed = Number(event.target.value)) });
  for (const one of SPEEDS) speed.append(make("option", { value: one, selected: one === cursor.speed }, `${one} of real time`));
  const names = make("input", { type: "checkbox", checked: shown.names });
  const controls = make("div", { class: "controls" }, button, bar, clock, timed ? make("label", {}, "speed ", speed) : null, make("label", {}, names, " names"));
  const figure = make("figure", { class: "animation" }, make("figcaption", {}, block.title), canvas, controls, efforts, keyOf(block));
  if (block.ghosts.length) {
    const choice = make("select", { "aria-label": "ghost" });
    for (const ghost of block.ghosts) choice.append(make("option", {}, ghost.name));
    choice.append(make("option", { value: "" }, "none"));
    choice.addEventListener("change", () => {
      shown.ghost = choice.value;
      draw(cursor.time);
    });
    controls.append(make("label", {}, "ghost ", choice));
  }
  const view = new View(block);
  const ctx = canvas.getContext("2d");
  function draw(time) {
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (!width) return;
    canvas.width = Math.round(width * devicePixelRatio);
    canvas.height = Math.round(height * devicePixelRatio);
    ctx.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    ctx.lineJoin = ctx.lineCap = "round";
    view.fit(width, height);
    drawFrame(ctx, view, block, time, shown);
    clock.textContent = `${said(Number(time.toPrecision(4)))} ${block.unit}`;
    const frame = frameAt(block.times, within(block, time));
    const drives = drivesShown(block, shown);
    const tracked = drives !== block.drives;
    efforts.textContent = drives.map((drive, k) => effortSaid(drive, frame, tracked ? block.drives[k] : null)).join("; ");
    bar.value = 1000 * ((time - cursor.low) / (cursor.high - cursor.low || 1));
    button.textContent = cursor.playing ? "Pause" : "Play";
  }
  names.addEventListener("change", () => {
    shown.names = names.checked;
    draw(cursor.time);
  });
  if (block.dimension === 3) turnByDragging(canvas, view, () => draw(cursor.time));
  whenSeen(figure, () => {
    cursor.listen(draw);
    theme.listeners.push(() => draw(cursor.time));
    whenSized(canvas, () => draw(cursor.time));
  });
  return figure;
}

/** Return an actuator's effort in words, with the limit that it is next to, and the planned effort beside a tracked one. */
function effortSaid(drive, frame, planned) {
  const effort = mixed(drive.effort, frame);
  const limit = effort < 0 ? drive.limits[0] : drive.limits[1];
  const number = (value) => said(Number(value.toPrecision(3)));
  const of = limit === null ? "" : ` of ${said(limit, 4)}`;
  const beside = planned === null ? "" : ` (planned ${number(mixed(planned.effort, frame))})`;
  return `${drive.name} ${number(effort)}${of} ${drive.unit}${beside}`;
}

/** Return what the drawing's lines and signs mean. */
function keyOf(block) {
  const moving = block.bodies.filter((body) => !body.fixed);
  const swatches = moving.slice(0, BODY_COLOURS).map((body) => make("li", {}, signOf(body), body.name));
  if (moving.length > BODY_COLOURS) swatches.push(make("li", {}, `and ${moving.length - BODY_COLOURS} more bodies`));
  if (block.bodies.some((body) => body.shapes.some((shape) => shape.look === "payload"))) swatches.push(make("li", {}, make("span", { class: "sign payload" }, "■"), "payload, as a uniform rod"));
  if (block.ghosts.length) swatches.push(make("li", {}, make("span", { class: "sign ghost" }, "╌"), `ghost: as tracked; solid: ${block.planned}`));
  block.paths.forEach(([name], k) => swatches.push(make("li", {}, make("span", { class: `sign c${(moving.length + k) % BODY_COLOURS}` }, "─"), `path of ${name}`)));
  const sites = sitesOf(block);
  if (sites.length) swatches.push(make("li", {}, make("span", { class: "sign" }, "◇"), sites.some(([, body]) => !body.fixed) ? "site, its path dotted" : "site"));
  const seen = block.dimension === 3 ? "drag to turn" : `seen with ${block.axes[0]} to the right and ${block.axes[1]} up`;
  const shapes = new Set(block.drives.flatMap((drive) => drive.marks.map((mark) => mark.shape)));
  const words = [["arc", "arcs"], ["arrow", "arrows"], ["line", "lines"]].filter(([shape]) => shapes.has(shape)).map(([, word]) => word);
  const whose = block.ghosts.some((ghost) => ghost.drives.length) ? "efforts of the ghost that is shown" : "efforts";
  const drives = words.length ? `; ${words.join(" and ")}: ${whose} against their limits, red at the limit` : "";
  return make("div", {}, make("ul", { class: "legend" }, ...swatches), make("p", { class: "hint" }, seen + drives));
}

/** Turn a view in space while a pointer drags on its canvas. */
function turnByDragging(canvas, view, draw) {
  canvas.classList.add("turns");
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (!event.buttons) return;
    view.yaw -= event.movementX * 0.01;
    view.pitch = Math.min(Math.max(view.pitch + event.movementY * 0.01, -1.57), 1.57);
    draw();
  });
}
