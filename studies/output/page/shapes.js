// The solid shapes of bodies on a canvas: outlines in a plane; shaded faces, far ones first, in space.

const LIGHT = [-0.35, 0.62, 0.7]; // the direction to the light: right, up, towards the eye

/** Return "#rrggbb" mixed with another colour by a share from 0 to 1. */
function blended(one, other, share) {
  const parts = [one, other].map((text) => [1, 3, 5].map((k) => parseInt(text.slice(k, k + 2), 16)));
  return `rgb(${parts[0].map((x, k) => Math.round(x + share * (parts[1][k] - x))).join(",")})`;
}

/** Return the function from a body's own points to the drawing's [m] at a frame. */
function placed(body, frame, dimension) {
  const row = mixed(body.places, frame);
  if (dimension === 2) {
    const size = Math.hypot(row[2], row[3]) || 1;
    const [c, s] = [row[2] / size, row[3] / size];
    return ([x, y]) => [row[0] + c * x - s * y, row[1] + s * x + c * y, 0];
  }
  const size = Math.hypot(...row.slice(3)) || 1;
  const [w, i, j, k] = row.slice(3).map((x) => x / size);
  return ([x, y, z]) => {
    const [a, b, c] = [2 * (j * z - k * y), 2 * (k * x - i * z), 2 * (i * y - j * x)];
    return [row[0] + x + w * a + j * c - k * b, row[1] + y + w * b + k * a - i * c, row[2] + z + w * c + i * b - j * a];
  };
}

/** Give the moving bodies of a document of 1.0, which names no colours, those of the series. */
function colourBodies(bodies) {
  bodies.filter((body) => !body.fixed).forEach((body, k) => (body.colour ||= `c${k % BODY_COLOURS}`));
}

/** Return a body's colour: the model's own, or that of the style sheet by its name. */
function bodyColour(body) {
  if (body.fixed) return theme.colour("fixed");
  return body.colour.startsWith("#") ? body.colour : theme.colour(body.colour);
}

/** Return the sign of a body in a legend. */
function signOf(body) {
  const own = body.colour.startsWith("#");
  const sign = make("span", { class: own ? "sign" : `sign ${body.colour}` }, "■");
  if (own) sign.style.color = body.colour;
  return sign;
}

/** Return the colour of a body's shape. */
function shapeColour(shape, body) {
  return shape.look === "payload" ? theme.colour("payload") : bodyColour(body);
}

/** Tell if a body has a shape of its own, so that no stick stands for it. */
function isShaped(body) {
  return body.shapes.some((shape) => shape.look === "geom");
}

/** Trace the path of points on the canvas; a single point is a dot. */
function trace(ctx, pixels) {
  ctx.beginPath();
  if (pixels.length === 1) ctx.arc(...pixels[0], 0.01, 0, 2 * Math.PI);
  else for (const point of pixels) ctx.lineTo(...point);
  if (pixels.length > 2) ctx.closePath();
}

/** Draw a body's shapes in a plane: all edges, then all fillings, so that the shapes of one body are one figure. */
function drawFlatShapes(ctx, view, body, place, colourOf) {
  const parts = body.shapes.map((shape) => {
    const pixels = triples(shape.points, 2).map((point) => view.at(place(point)));
    return { pixels, wide: Math.max(2 * shape.radius * view.scale, pixels.length < 3 ? 3 : 0), colour: colourOf(shape) };
  });
  for (const edge of [2.4, 0]) {
    for (const { pixels, wide, colour } of parts) {
      ctx.fillStyle = ctx.strokeStyle = edge ? colour : blended(colour, theme.colour("paper"), 0.45);
      ctx.lineWidth = wide + edge;
      trace(ctx, pixels);
      ctx.fill();
      if (wide + edge) ctx.stroke(); // a canvas ignores a width of 0
    }
  }
}

/** Draw the ghost's shapes in a plane, translucent. */
function drawFlatGhost(ctx, view, shapes, place) {
  ctx.globalAlpha = 0.3;
  ctx.fillStyle = ctx.strokeStyle = theme.colour("ghost");
  for (const shape of shapes) {
    ctx.lineWidth = Math.max(2 * shape.radius * view.scale, 1);
    trace(ctx, triples(shape.points, 2).map((point) => view.at(place(point))));
    ctx.fill();
    ctx.stroke();
  }
  ctx.globalAlpha = 1;
}

/** Return what a shape in space is painted of: faces towards the eye, or pieces of a thick line; each with its depth. */
function piecesOf(view, shape, place, colour) {
  const points = triples(shape.points, 3).map((point) => view.seen(place(point)));
  if (shape.faces.length) return shape.faces.flatMap((face) => faceOf(face.map((k) => points[k]), colour, 2 * shape.radius * view.scale));
  const wide = Math.max(2 * shape.radius * view.scale, 3);
  const [a, b] = [points[0], points.at(-1)];
  const ends = points.map((point) => ({ pixels: [point.slice(0, 2)], depth: point[2], colour, wide, round: true }));
  const n = points.length < 2 ? 0 : Math.min(12, Math.max(1, Math.ceil(Math.hypot(a[0] - b[0], a[1] - b[1]) / wide)));
  const rods = Array.from({ length: n }, (_, k) => {
    const [from, to] = [k / n, Math.min(1, (k + 1.02) / n)].map((share) => a.map((x, i) => x + share * (b[i] - x)));
    return { pixels: [from.slice(0, 2), to.slice(0, 2)], depth: (from[2] + to[2]) / 2 + 1e-3, colour, wide, round: true };
  });
  return [...ends, ...rods];
}

/** Return a face as a list of one piece, shaded by its slope to the light; of none where it looks away. */
function faceOf(corners, colour, wide) {
  const normal = [0, 0, 0]; // by Newell's rule; pixels run downwards
  corners.forEach((p, k) => {
    const q = corners[(k + 1) % corners.length];
    normal[0] += (-p[1] + q[1]) * (p[2] + q[2]);
    normal[1] += (p[2] - q[2]) * (p[0] + q[0]);
    normal[2] += (p[0] - q[0]) * (-p[1] - q[1]);
  });
  const size = Math.hypot(...normal);
  if (!(normal[2] > 1e-6 * size)) return [];
  const lit = normal.reduce((sum, x, k) => sum + (x / size) * LIGHT[k], 0);
  const depth = corners.reduce((sum, p) => sum + p[2], 0) / corners.length;
  return [{ pixels: corners.map((p) => [p[0], p[1]]), depth, colour, wide, lit: Math.max(0, lit) }];
}

/** Draw pieces in space, far ones first. */
function paintPieces(ctx, pieces) {
  const [dark, bright] = ["#000000", "#ffffff"];
  for (const piece of pieces.sort((a, b) => a.depth - b.depth)) {
    const layers = piece.round ? [[1, blended(piece.colour, dark, 0.3), 0], [0.8, piece.colour, 0.06], [0.35, blended(piece.colour, bright, 0.35), 0.16]] : [[1, piece.lit < 0.5 ? blended(piece.colour, dark, 0.45 - 0.9 * piece.lit) : blended(piece.colour, bright, 0.9 * (piece.lit - 0.5)), 0]];
    for (const [share, look, aside] of layers) {
      ctx.fillStyle = ctx.strokeStyle = look;
      ctx.lineCap = piece.pixels.length === 2 ? "butt" : "round";
      ctx.lineWidth = piece.round ? share * piece.wide : Math.max(piece.wide, 0.7);
      trace(ctx, piece.pixels.map(([x, y]) => [x - aside * piece.wide, y - aside * piece.wide]));
      if (!piece.round) ctx.fill();
      ctx.stroke();
    }
  }
  ctx.lineCap = "round";
}

/** Draw the ground's horizontal plane: a hatched line in a plane, a grid in space; nothing where it is far below. */
function drawFloor(ctx, view, height, width) {
  ctx.strokeStyle = theme.colour("faint");
  ctx.lineWidth = 1.2;
  ctx.beginPath();
  if (view.flat) {
    const y = view.at([0, height, 0])[1];
    if (y > ctx.canvas.clientHeight) return;
    ctx.moveTo(0, y);
    ctx.lineTo(width, y);
    for (let x = 0; x < width; x += 14) {
      ctx.moveTo(x + 8, y);
      ctx.lineTo(x, y + 8);
    }
  } else {
    if (Math.abs(height - view.middle[2]) > view.size[2]) return;
    const reach = 0.75 * Math.max(view.size[0], view.size[1]);
    for (let k = -4; k <= 4; k += 1) {
      for (const swap of [false, true]) {
        const ends = [-1, 1].map((end) => (swap ? [(k / 4) * reach, end * reach] : [end * reach, (k / 4) * reach]));
        ends.forEach(([x, y], i) => ctx[i ? "lineTo" : "moveTo"](...view.at([view.middle[0] + x, view.middle[1] + y, height])));
      }
    }
  }
  ctx.stroke();
}

/** Draw the scale, a bar of a round length, and in space the three directions. */
function drawScale(ctx, view, width, height) {
  const rough = 110 / view.scale;
  const power = 10 ** Math.floor(Math.log10(rough));
  const long = power * [5, 2, 1].find((one) => one * power <= rough);
  const [x, y, wide] = [14, height - 12, long * view.scale];
  ctx.strokeStyle = ctx.fillStyle = theme.colour("soft");
  ctx.lineWidth = 1.5;
  ctx.beginPath();
  for (const [a, b] of [[x, y - 5], [x, y], [x + wide, y], [x + wide, y - 5]]) ctx.lineTo(a, b);
  ctx.stroke();
  ctx.font = "12px system-ui, sans-serif";
  ctx.fillText(long < 1 ? `${said(1000 * long)} mm` : `${said(long)} m`, x + 5, y - 5);
  if (view.flat) return;
  [[1, 0, 0], [0, 1, 0], [0, 0, 1]].forEach((axis, k) => {
    const [dx, dy] = view.turned(axis).map((value) => (26 * value) / view.scale);
    ctx.beginPath();
    ctx.moveTo(width - 44, height - 40);
    ctx.lineTo(width - 44 + dx, height - 40 + dy);
    ctx.stroke();
    ctx.fillText("xyz"[k], width - 47 + 1.3 * dx, height - 36 + 1.3 * dy);
  });
}
