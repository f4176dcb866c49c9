// The page: header, contents, sections, and the keyboard.

const SHOW = {
  text: showText,
  facts: showFacts,
  table: showTable,
  checklist: showChecklist,
  plot: showPlot,
  plane: showPlane,
  bars: showBars,
  animation: showAnimation,
  code: showCode,
};

/** Return a section's element; plots stand beside one another where there is room, facts beside the animation before them. A folded one opens by its title. */
function showSection(section, id) {
  const heading = make(section.depth > 1 ? "h3" : "h2", {}, section.title);
  const blocks = [];
  const show = (block) => {
    try {
      return SHOW[block.kind](block);
    } catch (error) {
      return make("p", { class: "text bad" }, `This part cannot be shown: ${error.message}`);
    }
  };
  for (const block of section.blocks) {
    const small = ["plot", "plane", "bars"].includes(block.kind);
    if (small && blocks.length && blocks.at(-1).classList.contains("grid")) blocks.at(-1).append(show(block));
    else if (small) blocks.push(make("div", { class: "grid" }, show(block)));
    else if (block.kind === "facts" && blocks.length && blocks.at(-1).classList.contains("animation")) blocks.push(make("div", { class: "lead" }, blocks.pop(), show(block)));
    else if (SHOW[block.kind]) blocks.push(show(block));
  }
  const attributes = { id, class: `depth-${section.depth}` };
  if (!section.folded) return make("section", attributes, heading, ...blocks);
  return make("section", attributes, make("details", {}, make("summary", {}, heading), ...blocks));
}

/** Return what the keyboard and the pointer do on this page. */
function hintOf(report) {
  const blocks = report.sections.flatMap((section) => section.blocks);
  const moves = "the arrow keys move the cursor (with Shift by more), and so does pointing at a plot.";
  if (blocks.some((block) => block.kind === "animation")) return `Space plays and pauses, ${moves}`;
  return blocks.some((block) => block.kind === "plot" && block.group) ? `${moves[0].toUpperCase()}${moves.slice(1)}` : "";
}

/** Open the folded section that the address names, and those around it. */
function openNamed() {
  const named = document.getElementById(location.hash.slice(1));
  if (!named) return;
  const folded = [named.querySelector("details"), named.parentElement.closest("details")].filter((one) => one !== null);
  if (!folded.length) return;
  for (const one of folded) one.open = true;
  named.scrollIntoView();
}
addEventListener("hashchange", openNamed);

function showReport(report) {
  const ids = report.sections.map((_, k) => `section-${k + 1}`);
  const main = make("main", {});
  const links = [];
  let [host, below] = [main, Infinity]; // where sections go, and above which depth
  report.sections.forEach((section, k) => {
    if (section.depth <= below) [host, below] = [main, Infinity];
    const shown = showSection(section, ids[k]);
    host.append(shown);
    if (host === main) links.push(make("a", { href: `#${ids[k]}`, class: `depth-${section.depth}` }, section.title));
    if (section.folded && host === main) [host, below] = [shown.querySelector("details"), section.depth];
  });
  const button = make("button", { type: "button", class: "theme" }, "Light or dark");
  button.addEventListener("click", () => theme.set(theme.dark() ? "light" : "dark"));
  const tone = report.passed === null ? "" : report.passed ? "good" : "bad";
  const head = make("header", {}, make("div", { class: "bar" }, make("h1", {}, report.title), button));
  head.append(make("p", { class: `verdict ${tone}` }, report.verdict));
  head.append(make("p", { class: "hint keys" }, hintOf(report)));
  const nav = make("nav", { "aria-label": "contents" }, ...links);
  const versions = Object.entries(report.versions).map(([name, version]) => `${name} ${version}`);
  main.append(make("footer", {}, `Made by ${versions.join(", ")}.`));
  document.body.append(make("div", { class: "page" }, nav, make("div", { class: "column" }, head, main)));
  Cursor.active ??= [...Cursor.all.values()].find((one) => one.animated) ?? [...Cursor.all.values()][0] ?? null;
}

/** Return whether keys are another's: a field's, a button's, the browser's own. */
function isTaken(event) {
  const busy = event.target.closest ? event.target.closest("input, select, textarea, button, a, summary") : null;
  return busy || event.ctrlKey || event.metaKey || event.altKey;
}

document.addEventListener("keydown", (event) => {
  const cursor = Cursor.active;
  if (!cursor || isTaken(event)) return;
  const steps = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
  if (event.key === " ") (cursor.animated ? cursor : [...Cursor.all.values()].find((one) => one.animated) ?? cursor).toggle();
  else if (steps) cursor.step((steps * (event.shiftKey ? 10 : 1)) / 200);
  else return;
  event.preventDefault();
});

let before = null; // the theme to return to after printing
let folded = []; // what was folded before it
addEventListener("beforeprint", () => {
  if (document.documentElement.classList.contains("printing")) return;
  folded = [...document.querySelectorAll("details:not([open])")];
  for (const one of folded) one.open = true;
  before = document.documentElement.dataset.theme ?? "";
  document.documentElement.classList.add("printing"); // the paper's width, for what is drawn to a width
  for (const build of whenSeen.all) build();
  for (const fit of whenSized.all) fit();
  for (const place of document.querySelectorAll(".wide")) place.firstChild.style.zoom = Math.min(1, place.clientWidth / place.scrollWidth);
  theme.set("light");
});
addEventListener("afterprint", () => {
  document.documentElement.classList.remove("printing");
  for (const place of document.querySelectorAll(".wide")) place.firstChild.style.zoom = "";
  for (const one of folded) one.open = false;
  theme.set(before);
});

showReport(JSON.parse(document.getElementById("document").textContent));
openNamed();
