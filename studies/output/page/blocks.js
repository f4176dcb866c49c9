// The plainer blocks of a report: texts, facts, tables, checklists, code.

function showText(block) {
  return make("p", { class: `text ${block.tone}` }, block.text);
}

function showFacts(block) {
  return make("dl", { class: "facts" }, ...block.rows.flatMap(([label, value]) => [make("dt", {}, label), make("dd", {}, value)]));
}

/** Tell if a cell is a number, or a number's text with digits of its own, or with its interval. */
function isNumber(value) {
  return typeof value === "number" || (typeof value === "string" && value !== "" && value.split(" ± ").every((part) => Number.isFinite(Number(part))));
}

/** Return a cell: verdicts in words, all else to the right in a column of numbers. */
function cellOf(value, inNumbers) {
  if (typeof value === "boolean") return make("td", { class: value ? "good" : "bad" }, value ? "yes" : "NO");
  const text = value === null ? "–" : typeof value === "number" ? said(value) : String(value);
  return make("td", { class: inNumbers ? "number" : text.length < 30 ? "short" : false }, text);
}

/** Tell if at least half of a column's cells that hold anything are numbers. */
function isOfNumbers(cells) {
  const held = cells.filter((value) => value !== null && value !== "");
  return held.length > 0 && held.filter(isNumber).length >= held.length / 2;
}

// Tables of more rows scroll in a window of their own, their heads staying.
const WHOLE_ROWS = 40;

function showTable(block) {
  const numbers = block.columns.map((_, k) => isOfNumbers(block.rows.map((row) => row[k])));
  const heads = block.columns.map(([head, unit], k) => make("th", { scope: "col", class: numbers[k] ? "number" : false }, labelled({ label: head, unit })));
  const rows = block.rows.map((row) => make("tr", {}, ...row.map((value, k) => cellOf(value, numbers[k]))));
  const table = make("table", {}, make("thead", {}, make("tr", {}, ...heads)), make("tbody", {}, ...rows));
  const inner = make("div", { class: block.rows.length > WHOLE_ROWS ? "wide" : "wide whole", tabindex: 0, role: "region", "aria-label": block.title || "table" }, table);
  return make("figure", {}, block.title ? make("figcaption", {}, block.title) : null, inner);
}

/** Return a checklist; a line with an instant moves the cursor there. */
function showChecklist(block) {
  const heads = ["passed", "check", "worst", "limit", "at"].map((head) => make("th", { scope: "col" }, head));
  const rows = block.items.map((item) => {
    const value = (x) => (x === null ? "–" : withUnit(said(x), item.unit));
    const go = () => {
      cursorOf(block.group).pause();
      cursorOf(block.group).move(item.instant_s);
    };
    const at = item.instant_s === null ? "–" : make("button", { type: "button", class: "instant", title: "move the cursor there" }, `${said(item.instant_s)} s`);
    const verdict = make("td", { class: item.passed ? "good" : "bad" }, item.passed ? "✓" : "✗ NO");
    const cells = [verdict, make("td", {}, item.label), make("td", { class: "number" }, value(item.worst)), make("td", { class: "number" }, value(item.limit)), make("td", {}, at)];
    return make("tr", item.instant_s === null ? {} : { class: "goes", onclick: go }, ...cells);
  });
  const table = make("table", { class: "checklist" }, make("thead", {}, make("tr", {}, ...heads)), make("tbody", {}, ...rows));
  return make("figure", {}, make("figcaption", {}, block.title), make("div", { class: "wide whole" }, table));
}

function showCode(block) {
  const text = make("pre", { class: "code", tabindex: 0 }, block.text);
  const button = make("button", { type: "button", class: "copy" }, "Copy");
  button.addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(block.text);
      button.textContent = "Copied";
    } catch {
      getSelection().selectAllChildren(text); // pages without a clipboard: marked, to be copied by hand
      button.textContent = "Marked";
    }
  });
  return make("figure", {}, make("figcaption", {}, block.title, " ", button), text);
}
