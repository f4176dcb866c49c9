// A mechanism in motion on a canvas: flat in its plane, or in space, turned by dragging.

const BODY_COLOURS = 10;

const ARC = 24; // pixels
const SWEEP = (3 * Math.PI) / 4; // of the arc at the limit
const FARTHEST = 1.25; // of the limit that is drawn: an arc does not run into its own tail, and the words have the number

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
  const one = rows[Math.min(frame.at, rows.length - 1)];
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
    const widen = (point, radius = 0) =>
      point.forEach((x, k) => {
        low[k] = Math.min(low[k], x - radius);
        high[k] = Math.max(high[k], x + radius);
      });
    const rows = [block.bodies, ...block.ghosts.map((ghost) => ghost.bodies)].flat().flatMap((body) => body.points);
    for (const row of [...rows, ...block.paths.map((path) => path[1].flat())]) triples(row, block.dimension).forEach((point) => widen(point));
    for (const body of block.bodies) {
      for (let at = 0; at < body.places.length; at += Math.ceil(body.places.length / 40)) {
        const place = placed(body, { at, share: 0 }, block.dimension);
        for (const shape of body.shapes) triples(shape.points, block.dimension).forEach((point) => widen(place(point), shape.radius));
        for (const [, point] of body.sites) widen(place(point));
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

  /** Return the pixel of a place in space [m], and how near it is to the eye [px]. */
  seen(point) {
    const [x, y, z] = point.map((value, k) => value - this.middle[k]);
    const away = Math.cos(this.yaw) * y - Math.sin(this.yaw) * x;
    return [...this.at(point), (Math.sin(this.pitch) * z - Math.cos(this.pitch) * away) * this.scale];
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
  const drawn = Math.min(Math.max(share, -FARTHEST), FARTHEST);
  for (const mark of drive.marks) {
    if (mark.shape === "line") drawLine(ctx, view, triples(mixed(mark.at, frame), dimension), Math.abs(share), colour);
    else drawLoad(ctx, view, mark, frame, dimension, drawn, ends, colour);
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

/** Return the sites of moving bodies that have no path of their own: [name, body, point]. */
function sitesOf(block) {
  const named = new Set(block.paths.map(([name]) => name));
  return block.bodies.flatMap((body) => body.sites.filter(([name]) => !named.has(name)).map(([name, point]) => [name, body, point]));
}

/** Draw sites as diamonds, and the paths of those that move as dots. */
function drawSites(ctx, view, block, frame) {
  for (const [, body, point] of sitesOf(block)) {
    ctx.strokeStyle = theme.colour("soft");
    ctx.lineWidth = 1;
    if (!body.fixed) {
      ctx.setLineDash([1, 4]);
      ctx.beginPath();
      block.times.forEach((_, at) => ctx.lineTo(...view.at(placed(body, { at, share: 0 }, block.dimension)(point))));
      ctx.stroke();
      ctx.setLineDash([]);
    }
    const [x, y] = view.at(placed(body, frame, block.dimension)(point));
    ctx.fillStyle = theme.colour("paper");
    ctx.beginPath();
    for (const [dx, dy] of [[4, 0], [0, 4], [-4, 0], [0, -4]]) ctx.lineTo(x + dx, y + dy);
    ctx.closePath();
    ctx.fill();
    ctx.stroke();
  }
}

/** Draw pins as rings. */
function drawPins(ctx, view, block, frame) {
  const named = new Set(block.paths.map(([name]) => name));
  for (const [name, places] of block.labels) {
    if (named.has(name)) continue;
    const place = mixed(places, frame);
    ctx.beginPath();
    ctx.arc(...view.at([place[0], place[1], place[2] ?? 0]), 3.2, 0, 2 * Math.PI);
    ctx.fillStyle = theme.colour("paper");
    ctx.strokeStyle = theme.colour("ink");
    ctx.lineWidth = 1.4;
    ctx.fill();
    ctx.stroke();
  }
}

/** Write names beside their places, below one another where places fall together. */
function drawNames(ctx, view, block, frame) {
  ctx.font = "12px system-ui, sans-serif";
  const taken = [];
  const sites = sitesOf(block).map(([name, body, point]) => [name, placed(body, frame, block.dimension)(point)]);
  for (const [name, place] of [...block.labels.map(([name, places]) => [name, mixed(places, frame)]), ...sites]) {
    if (!name) continue;
    let [x, y] = view.at([place[0], place[1], place[2] ?? 0]);
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

/** Draw the bodies with their shapes: the ghost behind them, the nearest last. */
function drawBodies(ctx, view, block, frame, ghost) {
  const moving = block.bodies.filter((body) => !body.fixed);
  const colours = new Map(block.bodies.map((body) => [body, (shape) => shapeColour(shape, body)]));
  if (!view.flat) {
    const pieces = block.bodies.filter((body) => body.shapes.length).flatMap((body) => body.shapes.flatMap((shape) => piecesOf(view, shape, placed(body, frame, 3), colours.get(body)(shape))));
    paintPieces(ctx, pieces);
  } else {
    const shaped = block.bodies.filter((body) => body.shapes.length);
    for (const body of ghost ? shaped : []) {
      const other = ghost.bodies.find((one) => one.name === body.name);
      if (!body.fixed && other) drawFlatGhost(ctx, view, body.shapes, placed(other, frame, 2));
    }
    const ordered = shaped.reverse().sort((a, b) => a.depth - b.depth);
    for (const body of ordered) drawFlatShapes(ctx, view, body, placed(body, frame, 2), colours.get(body));
  }
  for (const body of [...moving].reverse()) {
    if (!isShaped(body)) drawBody(ctx, view, body, frame, block.dimension, bodyColour(body), 4);
  }
}

/** Draw one frame of an animation on a canvas of width and height [px]. */
function drawFrame(ctx, view, block, time, shown) {
  const frame = frameAt(block.times, within(block, time));
  const [width, height] = [ctx.canvas.clientWidth, ctx.canvas.clientHeight];
  const n = block.bodies.filter((body) => !body.fixed).length;
  for (const floor of block.floors) drawFloor(ctx, view, floor, width);
  for (const [index, [, places]] of block.paths.entries()) {
    ctx.strokeStyle = theme.colour(`c${(n + index) % BODY_COLOURS}`);
    ctx.lineWidth = 1.6;
    ctx.beginPath();
    for (const place of places) ctx.lineTo(...view.at([place[0], place[1], block.dimension === 3 ? place[2] : 0]));
    ctx.stroke();
  }
  const ghost = block.ghosts.find((one) => one.name === shown.ghost);
  drawBodies(ctx, view, block, frame, ghost);
  for (const body of block.bodies) if (body.fixed) drawBody(ctx, view, body, frame, block.dimension, theme.colour("fixed"), 4);
  if (ghost) {
    ctx.globalAlpha = 0.9;
    ctx.setLineDash([5, 4]);
    for (const body of ghost.bodies) if (!body.fixed) drawBody(ctx, view, body, frame, block.dimension, theme.colour("ghost"), 2);
    ctx.setLineDash([]);
    ctx.globalAlpha = 1;
  }
  drawSites(ctx, view, block, frame);
  drawPins(ctx, view, block, frame);
  for (const drive of drivesShown(block, shown)) drawDrive(ctx, view, drive, frame, block.dimension);
  if (shown.names) drawNames(ctx, view, block, frame);
  drawScale(ctx, view, width, height);
}
