// Curves in a plane: phase planes, Nyquist curves, maps. uPlot makes the axes, the curves are drawn on them.

const PLANE_HEIGHT = 360;
const SIDES = { left: 62, bottom: 46, padding: 24 };

/** Return the ends of an axis: the document's, or those of all curves with a little room. */
function endsOf(axis, rows) {
  if (axis.ends) return axis.ends;
  let [low, high] = [Infinity, -Infinity];
  for (const row of rows) {
    for (const value of row) {
      if (value === null) continue;
      if (value < low) low = value;
      if (value > high) high = value;
    }
  }
  if (!(high >= low)) return axis.log ? [0.1, 1] : [0, 1];
  if (axis.log) return [low / 1.1, high * 1.1];
  const room = 0.06 * (high - low) || 0.1 * Math.abs(high) || 1;
  return [low - room, high + room];
}

/** Return blue for low values, red for high ones, through the paper's colour, for a share from 0 to 1. */
function heatColour(share) {
  const x = Math.min(Math.max(share, 0), 1) * 2 - 1;
  const [r, g, b] = x < 0 ? [0, 114, 178] : [213, 94, 0];
  return `rgba(${r},${g},${b},${(0.85 * Math.abs(x)).toFixed(3)})`;
}

function drawHeat(u, heat) {
  const { ctx } = u;
  const edges = (places, scale) => {
    const at = places.map((x) => u.valToPos(x, scale, true));
    const middle = at.slice(1).map((x, k) => (x + at[k]) / 2);
    return [2 * at[0] - middle[0], ...middle, 2 * at[at.length - 1] - middle[middle.length - 1]];
  };
  const [columns, rows] = [edges(heat.x, "x"), edges(heat.y, "y")];
  const whole = make("canvas", { width: ctx.canvas.width, height: ctx.canvas.height }); // printed, single cells would show their seams
  const cells = whole.getContext("2d");
  heat.values.forEach((row, j) =>
    row.forEach((value, i) => {
      if (value === null) return;
      cells.fillStyle = heatColour((value - heat.ends[0]) / (heat.ends[1] - heat.ends[0]));
      const [left, right] = [columns[i], columns[i + 1]].sort((a, b) => a - b).map(Math.round);
      const [top, bottom] = [rows[j], rows[j + 1]].sort((a, b) => a - b).map(Math.round);
      cells.fillRect(left, top, right - left, bottom - top);
    }),
  );
  ctx.drawImage(whole, 0, 0);
}

function drawMark(ctx, look, x, y, size) {
  ctx.beginPath();
  if (look === "cross") {
    ctx.moveTo(x - size, y - size);
    ctx.lineTo(x + size, y + size);
    ctx.moveTo(x - size, y + size);
    ctx.lineTo(x + size, y - size);
    ctx.stroke();
  } else if (look === "star") {
    for (let k = 0; k < 10; k += 1) {
      const r = k % 2 ? size : 2.4 * size;
      ctx.lineTo(x + r * Math.sin((k * Math.PI) / 5), y - r * Math.cos((k * Math.PI) / 5));
    }
    ctx.closePath();
    ctx.fill();
  } else {
    ctx.arc(x, y, size, 0, 2 * Math.PI);
    ctx.fill();
  }
}

function drawCurve(u, curve) {
  const { ctx } = u;
  const ratio = devicePixelRatio;
  ctx.strokeStyle = ctx.fillStyle = theme.series(curve.colour);
  ctx.lineWidth = curve.width * ratio;
  ctx.setLineDash(dashes(curve.look).map((length) => length * ratio));
  const at = curve.x.map((x, k) =>
    x === null || curve.y[k] === null ? null : [u.valToPos(x, "x", true), u.valToPos(curve.y[k], "y", true)],
  );
  if (["points", "cross", "star"].includes(curve.look)) {
    for (const point of at) if (point) drawMark(ctx, curve.look, point[0], point[1], 3.2 * ratio);
    return;
  }
  ctx.beginPath();
  let down = false;
  for (const point of at) {
    if (point && down) ctx.lineTo(...point);
    else if (point) ctx.moveTo(...point);
    down = point !== null;
  }
  if (curve.look === "area") {
    ctx.globalAlpha = 0.15;
    ctx.fill();
    ctx.globalAlpha = 1;
  } else ctx.stroke();
}

/** Return the legend of a plane: a swatch and a name for each curve that has one. */
function legendOf(curves) {
  const named = curves.filter((curve) => curve.name);
  return make(
    "ul",
    { class: "legend" },
    ...named.map((curve) => {
      const sign = { points: "●", cross: "×", star: "★", area: "▒", dash: "╌", dots: "┈" }[curve.look] || "━";
      return make("li", {}, make("span", { class: `sign ${theme.named(curve.colour)}` }, sign), curve.name);
    }),
  );
}

/** Return the figure of a plane. */
function showPlane(block) {
  const place = make("div", { class: "canvas", style: `min-height:${PLANE_HEIGHT}px` });
  const figure = make("figure", { class: "plane" }, make("figcaption", {}, block.title), place, legendOf(block.curves));
  if (block.heat) {
    const [low, high] = block.heat.ends.map((value) => withUnit(said(value), block.heat.unit));
    figure.append(make("p", { class: "limits" }, make("span", { class: "swatch heat" }), `${block.heat.name}: from ${low} (blue) to ${high} (red)`));
  }
  if (block.group && block.track_times.length) cursorOf(block.group).reach(block.track_times[0], block.track_times.at(-1));
  whenSeen(figure, () => buildPlane(block, place));
  return figure;
}

function buildPlane(block, place) {
  const all = block.curves;
  const heat = block.heat;
  const ends = {
    x: endsOf(block.x_axis, [...all.map((curve) => curve.x), heat ? heat.x : []]),
    y: endsOf(block.y_axis, [...all.map((curve) => curve.y), heat ? heat.y : []]),
  };
  const size = () => ({ width: Math.max(Math.min(place.clientWidth, 620), 200), height: PLANE_HEIGHT });
  const framed = (u) => {
    if (!block.equal) return ends;
    const inner = [u.width - SIDES.left - SIDES.padding, u.height - SIDES.bottom - SIDES.padding];
    const scale = Math.max((ends.x[1] - ends.x[0]) / inner[0], (ends.y[1] - ends.y[0]) / inner[1]);
    const around = ([low, high], pixels) => [(low + high - scale * pixels) / 2, (low + high + scale * pixels) / 2];
    return { x: around(ends.x, inner[0]), y: around(ends.y, inner[1]) };
  };
  const scale = (side) => ({ time: false, distr: block[`${side}_axis`].log ? 3 : 1, range: (u) => framed(u)[side] });
  const plot = new uPlot(
    {
      ...size(),
      pxAlign: 0,
      padding: [SIDES.padding, SIDES.padding, 0, 0],
      scales: { x: scale("x"), y: scale("y") },
      axes: [axisOf(block.x_axis, "x"), block.equal ? { ...axisOf(block.y_axis, "y"), size: SIDES.left - 20 } : axisOf(block.y_axis, "y")],
      series: [{}, { points: { show: false }, paths: () => null }],
      legend: { show: false },
      cursor: { show: false },
      hooks: {
        drawAxes: [
          (u) => {
            const { ctx, bbox } = u;
            ctx.save();
            ctx.beginPath();
            ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
            ctx.clip();
            if (heat) drawHeat(u, heat);
            for (const curve of all) drawCurve(u, curve);
            ctx.restore();
          },
        ],
      },
    },
    [ends.x, ends.y],
    place,
  );
  place.style.minHeight = "";
  const follow = block.track === null || !block.group ? () => null : withDot(plot, block);
  theme.listeners.push(() => plot.redraw(false, true)); // true: a new size that waits to be drawn is kept
  whenSized(place, () => {
    if (!place.clientWidth || size().width === plot.width) return;
    plot.setSize(size());
    for (const [side, [min, max]] of Object.entries(framed(plot))) plot.setScale(side, { min, max });
    follow();
  });
}

/** Put a dot on a plane that moves with the cursor, and moves it; return what puts it in its place again. */
function withDot(plot, block) {
  const cursor = cursorOf(block.group);
  const curve = block.curves[block.track];
  const dot = make("div", { class: "dot" });
  plot.over.append(dot);
  const follow = () => {
    const frame = frameAt(block.track_times, within(block, cursor.time));
    const x = plot.valToPos(mixed(curve.x, frame), "x");
    const y = plot.valToPos(mixed(curve.y, frame), "y");
    dot.style.transform = `translate(${x}px, ${y}px)`;
  };
  queueMicrotask(() => cursor.listen(follow)); // when the plot has its axes
  plot.over.style.touchAction = "pan-y";
  plot.over.addEventListener("pointermove", (event) => {
    if (cursor.playing || (event.pointerType !== "mouse" && !event.buttons)) return;
    const box = plot.over.getBoundingClientRect();
    let [best, found] = [1600, null]; // within forty pixels
    curve.x.forEach((x, k) => {
      if (x === null || curve.y[k] === null) return;
      const away = (plot.valToPos(x, "x") - event.clientX + box.left) ** 2 + (plot.valToPos(curve.y[k], "y") - event.clientY + box.top) ** 2;
      if (away < best) [best, found] = [away, k];
    });
    if (found !== null) cursor.move(block.track_times[found]);
  });
  return follow;
}
