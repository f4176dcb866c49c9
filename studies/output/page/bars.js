// Bars beside names: what a whole is made of, what a figure owes to each cause. Plain elements, placed in per cent.

/** Return round places between two values, some five of them. */
function roundTicks(low, high) {
  const rough = (high - low) / 5;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((one) => one * power >= rough * 0.999);
  const ticks = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k += 1) ticks.push(Number((k * step).toPrecision(12)));
  return ticks;
}

/** Return the ends of what bars take: all of them, their intervals, and the line that they stand on. */
function barEnds(block) {
  const values = block.rows.flatMap((row) => row.spans.flatMap((span) => [span.start, span.end, span.low, span.high]));
  const known = [...values, block.line].filter((x) => x !== null && x !== undefined);
  const [low, high] = [Math.min(...known), Math.max(...known)];
  const room = 0.03 * (high - low) || 0.1 * Math.abs(high) || 1;
  return [low < block.line ? low - room : low, high > block.line ? high + room : high];
}

/** Return a name that may be broken after its points and underscores. */
function breakable(name) {
  return name.split(/(?<=[_,])|(?<=[.])(?![0-9])/).flatMap((part) => [part, make("wbr")]);
}

/** Return the figure of bars. */
function showBars(block) {
  const [low, high] = barEnds(block);
  const at = (x) => (100 * (x - low)) / (high - low || 1);
  const line = (x, kind) => make("span", { class: `upright ${kind}`, style: `left:${at(x)}%` });
  const ticks = roundTicks(low, high);
  const rows = block.rows.flatMap((row) => {
    const track = make("div", { class: "track" }, ...ticks.map((x) => line(x, "tick")), line(block.line, "base"));
    row.spans.forEach((span, k) => {
      const [from, to] = [Math.min(span.start, span.end), Math.max(span.start, span.end)];
      const [top, tall] = [8 + (84 * k) / row.spans.length, 84 / row.spans.length];
      const colour = span.colour === null ? "ink" : `c${span.colour % 7}`;
      const box = `left:${at(from)}%;width:${Math.max(at(to) - at(from), 0)}%;top:${top}%;height:${tall}%`;
      track.append(make("span", { class: `bar ${colour}`, style: box, title: `${span.name} ${said(span.end)}` }));
      if (span.low === null || span.high === null) return;
      track.append(make("span", { class: "interval", style: `left:${at(span.low)}%;width:${at(span.high) - at(span.low)}%;top:${top + tall / 2}%` }));
    });
    return [make("div", { class: "name" }, ...breakable(row.label)), track, make("div", { class: "note" }, row.note)];
  });
  const scale = make("div", { class: "scale" }, ...ticks.map((x) => make("span", { style: `left:${at(x)}%` }, said(x, 6))));
  const chart = make("div", { class: "bars", role: "img", "aria-label": block.title }, ...rows, make("div"), scale, make("div"));
  chart.append(make("div"), make("div", { class: "axis" }, labelled(block.axis)), make("div", { class: "note" }, block.note_name));
  return make("figure", { class: "chart" }, make("figcaption", {}, block.title), chart, barLegend(block));
}

/** Return what the colours of bars mean, each name once. */
function barLegend(block) {
  const named = new Map(block.rows.flatMap((row) => row.spans).filter((span) => span.name).map((span) => [span.name, span.colour]));
  const entries = [...named].map(([name, colour]) => make("li", {}, make("span", { class: `sign ${colour === null ? "whole" : `c${colour % 7}`}` }, "■"), name));
  if (block.rows.some((row) => row.spans.some((span) => span.low !== null))) entries.push(make("li", {}, make("span", { class: "sign ink" }, "┝━┥"), "95 % interval"));
  if (block.line_name) entries.push(make("li", {}, make("span", { class: "sign ink" }, "│"), block.line_name));
  return make("ul", { class: "legend" }, ...entries);
}
