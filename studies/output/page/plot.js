// Quantities over a common axis, drawn by uPlot; plots of one group share their cursor.

const HEIGHT = 210;
const NUMBER_WIDTH = 6.6; // of a letter beside an axis [px]
// The border that stands for a look in a legend, where style sheets know no other.
const BORDERS = { dash: "dashed", dashdot: "dashed", dots: "dotted", points: "dotted" };

/** Return the ticks of a logarithmic axis: powers of ten, their multiples where there are few, even steps within one. */
function logTicks(low, high, most) {
  const found = (multiples) => {
    const ticks = [];
    for (let k = Math.floor(Math.log10(low)); k <= Math.ceil(Math.log10(high)); k += 1) {
      for (const m of multiples) ticks.push(Number((m * 10 ** k).toPrecision(3)));
    }
    return ticks.filter((x) => x >= low * 0.999999 && x <= high * 1.000001);
  };
  for (const multiples of [[1, 1.5, 2, 3, 4, 5, 7], [1, 2, 5], [1, 3], [1]]) {
    const ticks = found(multiples);
    if (ticks.length > most) continue;
    if (ticks.length > 1) return ticks;
    return [0, 1, 2, 3].map((k) => Number((low + (k * (high - low)) / 3).toPrecision(3)));
  }
  const tens = found([1]);
  const every = Math.ceil(tens.length / most);
  return tens.filter((x) => Math.round(Math.log10(x)) % every === 0);
}

/** Return an axis of uPlot for one of the document. */
function axisOf(axis, side) {
  const own = axis.log
    ? {
        splits: (u, k, low, high) => logTicks(low, high, Math.max(2, u.bbox[side === "x" ? "width" : "height"] / devicePixelRatio / (side === "x" ? 55 : 26))),
        filter: (u, splits) => splits,
      }
    : {};
  return {
    ...own,
    label: labelled(axis),
    labelFont: "12px system-ui, sans-serif",
    font: "11px system-ui, sans-serif",
    labelSize: 20,
    labelGap: 2,
    stroke: () => theme.colour("ink"),
    grid: { stroke: () => theme.colour("grid"), width: 1 },
    ticks: { stroke: () => theme.colour("grid"), width: 1, size: 4 },
    gap: 4,
    space: side === "x" ? (u, k, low, high) => Math.max(50, 16 + NUMBER_WIDTH * Math.max(...[low, high].map((x) => said(x, 3).length))) : 30,
    size: side === "x" ? 26 : (u, values) => 14 + NUMBER_WIDTH * Math.max(3, ...(values || []).map((v) => (v ? v.length : 0))),
    values: (u, splits) => splits.map((v) => (v === null || v === undefined ? "" : said(v, 6))),
  };
}

/** Return a scale of uPlot: the document's ends, or those of the data and of `others` with a little room. */
function scaleOf(axis, others = [], room = 0.06) {
  return {
    time: false,
    distr: axis.log ? 3 : 1,
    range: (u, low, high) => {
      if (axis.ends) return axis.ends;
      if (low === null || low === undefined || high === null || !Number.isFinite(low)) [low, high] = axis.log ? [0.1, 1] : [0, 1];
      for (const value of others) [low, high] = [Math.min(low, value), Math.max(high, value)];
      if (axis.log) {
        const factor = Math.max((high / low) ** room, room ? 1.05 : 1);
        return [low / factor, high * factor];
      }
      const margin = room * (high - low) || (room ? 0.1 * Math.abs(high) || 1 : 0);
      return [low - margin, high + margin];
    },
  };
}

/** Return uPlot's table of a plot: x, then each series, those with an x of their own joined in. */
function tableOf(block) {
  const shared = block.series.filter((one) => !one.x);
  if (shared.length === block.series.length) return [block.x, ...shared.map((one) => one.y)];
  const tables = block.series.map((one) => [one.x || block.x, one.y]);
  return uPlot.join(tables, tables.map((table) => table.map(() => 1)));
}

/** Return the row next to `index` at which a series has a value: of its own places alone, and not beyond its ends. */
function nearest(values, index) {
  if (index === null || (values[index] !== null && values[index] !== undefined)) return index;
  const known = (at, step) => {
    while (at >= 0 && at < values.length && (values[at] === null || values[at] === undefined)) at += step;
    return at >= 0 && at < values.length ? at : null;
  };
  const [before, after] = [known(index, -1), known(index, 1)];
  if (before === null || after === null) return index;
  return index - before <= after - index ? before : after;
}

/** Draw the limits of a plot across it, each with its name where there is room. */
function drawLimits(u, limits) {
  const { ctx, bbox } = u;
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  ctx.strokeStyle = ctx.fillStyle = theme.colour("limit");
  ctx.lineWidth = 1.2 * devicePixelRatio;
  ctx.setLineDash([3 * devicePixelRatio, 3 * devicePixelRatio]);
  ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
  for (const limit of limits) {
    const y = u.valToPos(limit.value, "y", true);
    ctx.beginPath();
    ctx.moveTo(bbox.left, y);
    ctx.lineTo(bbox.left + bbox.width, y);
    ctx.stroke();
  }
  ctx.restore();
}

const MEASURED = ", measured";
// A dot within this of the cursor is at it [px]: its number beside the line's is of the same place.
const BESIDE = 6;

/** Return the numbers in uPlot of what was measured of a line, by the line's own: both stand in one line of the legend. */
function measuredOf(block) {
  const at = new Map(block.series.map((one, k) => [one.name, k + 1]));
  const dots = block.series.filter((one) => one.look === "points" && one.name.endsWith(MEASURED));
  const pairs = dots.map((one) => [at.get(one.name.slice(0, -MEASURED.length)), at.get(one.name)]);
  return new Map(pairs.filter(([line]) => line !== undefined));
}

/** Return uPlot's series for one of the document; `dots` is the number of what was measured of it, if anything was. */
function seriesOf(one, dots) {
  const points = one.look === "points";
  const colour = () => theme.series(one.colour);
  return {
    label: one.name,
    stroke: colour,
    width: points ? 0 : one.width,
    dash: dashes(one.look),
    paths: points ? () => null : one.look === "steps" ? uPlot.paths.stepped({ align: 1 }) : undefined,
    points: points ? { show: true, size: 6, stroke: colour, fill: colour } : { show: false },
    value: (u, v) => {
      if (!dots) return said(v);
      const [here, at] = [u.cursor.idx, nearest(u.data[dots], u.cursor.idx)];
      if (here === null || here === undefined || u.data[dots][at] === null || u.data[dots][at] === undefined) return said(v);
      const [x, dot] = [here, at].map((k) => u.valToPos(u.data[0][k], "x"));
      return Math.abs(x - dot) > BESIDE ? said(v) : `${said(v)} ● ${said(u.data[dots][at], 4)}`;
    },
  };
}

/** Return the figure of a plot. */
function showPlot(block) {
  const place = make("div", { class: "canvas", style: `min-height:${HEIGHT + 60}px` });
  const figure = make("figure", { class: block.group ? "plot" : "plot still" }, make("figcaption", {}, `${block.title}${measuredOf(block).size ? "; dots measured" : ""}`), place);
  const cursor = block.group ? cursorOf(block.group) : null;
  const known = block.x.filter((x) => x !== null);
  if (cursor && known.length) cursor.reach(known[0], known[known.length - 1]);
  if (cursor) cursor.log = block.x_axis.log;
  if (block.limits.length) {
    figure.append(make("p", { class: "limits" }, make("span", { class: "swatch limit" }), limitsSaid(block)));
  }
  whenSeen(figure, () => buildPlot(block, place, cursor));
  return figure;
}

/** Return the limits of a plot in words, those of one name together. */
function limitsSaid(block) {
  const named = new Map();
  for (const limit of block.limits) named.set(limit.name, [...(named.get(limit.name) || []), said(limit.value)]);
  const words = [...named].map(([name, values]) => {
    const several = values.length > 1 ? name.replace(/^limit\b/, "limits") : name;
    return `${several} ${withUnit(values.join(" and "), block.y_axis.unit)}`;
  });
  return words.join(", ");
}

function buildPlot(block, place, cursor) {
  const table = tableOf(block);
  const measured = measuredOf(block);
  const styled = (u, k) => `var(--${theme.named(block.series[k - 1]?.colour)})`; // an element's colour follows the style sheet
  let own = false; // the cursor is being moved by this program, not by a hand
  const options = {
    width: Math.max(place.clientWidth, 200),
    height: HEIGHT,
    pxAlign: 0,
    padding: [8, 24, 0, 0],
    scales: { x: scaleOf(block.x_axis, [], 0), y: scaleOf(block.y_axis, block.limits.map((limit) => limit.value)) },
    axes: [axisOf(block.x_axis, "x"), axisOf(block.y_axis, "y")],
    series: [{ label: labelled(block.x_axis), value: (u, v) => said(v) }, ...block.series.map((one, k) => seriesOf(one, measured.get(k + 1)))],
    cursor: {
      y: false,
      drag: { x: false, y: false, setScale: false },
      dataIdx: (u, index, at) => nearest(u.data[index], at),
      points: { size: 7, fill: styled, stroke: styled },
      bind: { mouseleave: () => () => (cursor ? follow(cursor.time) : null), dblclick: () => () => null },
    },
    legend: { markers: { stroke: styled, dash: (u, k) => BORDERS[block.series[k - 1]?.look] ?? "solid" } },
    hooks: {
      ready: [() => cursor && cursor.listen(follow)],
      draw: [(u) => drawLimits(u, block.limits)],
      setSeries: [(u, k, what) => what.show !== undefined && measured.has(k) && u.setSeries(measured.get(k), { show: what.show })],
      setCursor: [
        (u) => {
          if (own || !cursor || u.cursor.left < 0) return;
          if (!u.root.matches(":hover") || cursor.playing) return;
          cursor.move(u.posToVal(u.cursor.left, "x"));
        },
      ],
    },
  };
  const plot = new uPlot(options, table, place);
  place.style.minHeight = "";
  const legend = place.querySelectorAll(".u-legend .u-series");
  for (const dots of measured.values()) legend[dots].style.display = "none";
  block.series.forEach((one, k) => one.name || (legend[k + 1].style.display = "none"));
  function follow(time) {
    own = true;
    const left = plot.valToPos(within(block, time), "x");
    const inside = left > -1 && left < plot.bbox.width / devicePixelRatio + 1;
    plot.setCursor({ left: inside ? Math.max(left, 0) : -10, top: 1 });
    own = false;
  }
  if (cursor) {
    const drag = (event) => {
      if (event.pointerType === "mouse" && !event.buttons) return;
      cursor.pause();
      cursor.move(plot.posToVal(event.clientX - plot.over.getBoundingClientRect().left, "x"));
    };
    plot.over.style.touchAction = "pan-y";
    plot.over.addEventListener("pointerdown", drag);
    plot.over.addEventListener("pointermove", drag);
  }
  theme.listeners.push(() => plot.redraw(false, true)); // true: a new size that waits to be drawn is kept
  whenSized(place, () => {
    if (Math.abs(place.clientWidth - plot.width) < 1 || !place.clientWidth) return;
    plot.setSize({ width: place.clientWidth, height: HEIGHT });
    if (cursor) follow(cursor.time);
  });
}
