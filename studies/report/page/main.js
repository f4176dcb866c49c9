// The page: header, contents, sections, and the keyboard.

const SHOW = {
  text: showText,
  facts: showFacts,
  table: showTable,
  checklist: showChecklist,
  plot: showPlot,
  plane: showPlane,
  animation: showAnimation,
  code: showCode,
};

/** Return a section's element; plots stand beside one another where there is room. */
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
    const small = block.kind === "plot" || block.kind === "plane";
    if (small && blocks.length && blocks.at(-1).classList.contains("grid")) blocks.at(-1).append(show(block));
    else if (small) blocks.push(make("div", { class: "grid" }, show(block)));
    else if (SHOW[block.kind]) blocks.push(show(block));
  }
  return make("section", { id, class: `depth-${section.depth}` }, heading, ...blocks);
}

function showReport(report) {
  const ids = report.sections.map((_, k) => `section-${k + 1}`);
  const links = report.sections.map((section, k) => make("a", { href: `#${ids[k]}`, class: `depth-${section.depth}` }, section.title));
  const button = make("button", { type: "button", class: "theme" }, "Light or dark");
  button.addEventListener("click", () => theme.set(theme.dark() ? "light" : "dark"));
  const tone = report.passed === null ? "" : report.passed ? "good" : "bad";
  const head = make("header", {}, make("div", { class: "bar" }, make("h1", {}, report.title), button));
  head.append(make("p", { class: `verdict ${tone}` }, report.verdict));
  head.append(make("p", { class: "hint keys" }, "Space plays and pauses, the arrow keys move the cursor (with Shift by more); so does pointing at a plot over time."));
  const nav = make("nav", { "aria-label": "contents" }, ...links);
  const main = make("main", {}, ...report.sections.map((section, k) => showSection(section, ids[k])));
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
addEventListener("beforeprint", () => {
  before = document.documentElement.dataset.theme ?? "";
  for (const build of whenSeen.all) build();
  theme.set("light");
});
addEventListener("afterprint", () => theme.set(before));

showReport(JSON.parse(document.getElementById("document").textContent));
