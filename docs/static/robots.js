// Filters and sorts the table of robots in the page. Without JavaScript the whole table is shown.
(() => {
  const table = document.querySelector("table.robots");
  const form = document.getElementById("robot-filters");
  const heads = [...table.tHead.rows[0].cells];
  const column = Object.fromEntries(heads.map((head, index) => [head.textContent.trim(), index]));
  const text = (row, name) => row.cells[column[name]].textContent.trim();
  const number = (row, name) => (text(row, name) === "" ? NaN : Number(text(row, name)));
  const rows = [...table.tBodies[0].rows];
  const robots = rows.map((row) => {
    const degrees = number(row, "error [deg]");
    return {
      row,
      words: `${text(row, "model")} ${text(row, "note")}`.toLowerCase(),
      set: text(row, "set"),
      freedoms: number(row, "freedoms"),
      time: number(row, "new [s]") + number(row, "plan [s]"),
      error: Number.isNaN(degrees) ? number(row, "error [mm]") : degrees,
      planned: text(row, "plan [s]") === "" ? "no" : "yes",
    };
  });

  for (const name of new Set(robots.map((robot) => robot.set))) form.elements.set.add(new Option(name));

  // A bound that is empty excludes nothing; a row without the number fails a bound that is given.
  const within = (value, field, compare) => field.value === "" || compare(value, Number(field.value));
  const atMost = (value, bound) => value <= bound;
  const atLeast = (value, bound) => value >= bound;

  function filter() {
    const fields = form.elements;
    let shown = 0;
    for (const robot of robots) {
      const fits =
        robot.words.includes(fields.text.value.trim().toLowerCase()) &&
        (fields.set.value === "" || robot.set === fields.set.value) &&
        (fields.planned.value === "" || robot.planned === fields.planned.value) &&
        within(robot.freedoms, fields.least, atLeast) &&
        within(robot.freedoms, fields.most, atMost) &&
        within(robot.time, fields.time, atMost) &&
        within(robot.error, fields.error, atMost);
      robot.row.hidden = !fits;
      shown += fits;
    }
    fields.shown.value = `${shown} of ${robots.length} models`;
  }

  // Numbers ascend before empty cells; a second click on a head reverses the order.
  function sort(index) {
    const head = heads[index];
    const sign = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
    for (const other of heads) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", sign === 1 ? "ascending" : "descending");
    const cell = (row) => row.cells[index].textContent.trim();
    const isNumeric = rows.every((row) => cell(row) === "" || !Number.isNaN(Number(cell(row))));
    const compare = (a, b) => {
      if (cell(a) === "" || cell(b) === "") return (cell(a) === "") - (cell(b) === "");
      return sign * (isNumeric ? Number(cell(a)) - Number(cell(b)) : cell(a).localeCompare(cell(b)));
    };
    table.tBodies[0].append(...rows.sort(compare));
  }

  heads.forEach((head, index) => {
    head.tabIndex = 0;
    head.addEventListener("click", () => sort(index));
    head.addEventListener("keydown", (event) => event.key === "Enter" && sort(index));
  });
  form.addEventListener("input", filter);
  form.addEventListener("reset", () => setTimeout(filter));
  form.addEventListener("submit", (event) => event.preventDefault());
  form.hidden = false;
  filter();
})();
