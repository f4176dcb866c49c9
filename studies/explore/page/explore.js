// The sliders above a report: a moved slider asks for a new plan, and the page shows it.

const explored = { busy: false, due: false, values: {}, objective: null, tracker: null };

async function ask(path, body) {
  const options = body === undefined ? {} : { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) };
  const response = await fetch(path, options);
  if (!response.ok) throw new Error(await response.text());
  return response.json();
}

/** Show another report in place of the page's. */
function showAgain(report) {
  const before = Cursor.active;
  const at = before && before.high > 0 ? before.time / before.high : 0;
  document.querySelector(".page").remove();
  Cursor.all.clear();
  Cursor.active = null;
  theme.listeners.length = whenSeen.all.length = whenSized.all.length = 0;
  const top = scrollY;
  showReport(report);
  scrollTo(0, top);
  if (Cursor.active) Cursor.active.move(at * Cursor.active.high);
}

/** Tell why there is no plan at the present values: the plan before them stays as a faint picture, without its verdict. */
function refuse(said, why) {
  said.textContent = why;
  said.className = "said bad";
  const page = document.querySelector(".page");
  page.classList.add("stale");
  const verdict = page.querySelector(".verdict");
  if (!verdict) return;
  verdict.className = "verdict bad";
  verdict.textContent = `Not of these values: ${why}`;
}

/** Plan at the present values; while a plan is made, only the last change waits. */
async function planAgain(said) {
  explored.due = true;
  if (explored.busy) return;
  explored.busy = true;
  while (explored.due) {
    explored.due = false;
    said.textContent = "planning ...";
    try {
      const { values, objective, tracker } = explored;
      const answer = await ask("plan", { values, objective, tracker });
      if (answer.refused) refuse(said, answer.refused);
      else {
        showAgain(answer.document);
        said.className = "said";
        said.textContent = `${answer.said.message}; planned in ${said2(answer.said.plan_s)}, with tracking ${said2(answer.said.all_s)}`;
      }
    } catch (error) {
      refuse(said, `no answer: ${error.message}`);
    }
  }
  explored.busy = false;
}

function said2(seconds) {
  return `${Math.round(1000 * seconds)} ms`;
}

async function showSliders() {
  const controls = await ask("controls");
  const said = make("output", { class: "said", role: "status" }, "move a slider");
  const rows = controls.sliders.map((slider) => slidingRow(slider, said));
  const choices = ["objective", "tracker"].map((name) => choiceRow(name, controls[`${name}s`], controls[name], said));
  const save = make("button", { type: "button" }, "Save problem file");
  save.addEventListener("click", async () => {
    try {
      const answer = await ask("save", {});
      const last = document.querySelector(".page.stale") ? " (the last values that have a problem)" : "";
      said.textContent = answer.refused ?? `saved ${answer.saved}${last}`;
    } catch (error) {
      said.textContent = `no answer: ${error.message}`;
    }
  });
  const form = make("form", { class: "explore", "aria-label": "sliders" }, ...rows, ...choices, save, said);
  form.addEventListener("submit", (event) => event.preventDefault());
  document.body.prepend(form);
}

/** A slider with a number box; either moves the other, and both ask for a plan. */
function slidingRow(slider, said) {
  explored.values[slider.key] = slider.value;
  const input = make("input", { type: "range", min: slider.low, max: slider.high, step: "any", value: slider.value, "aria-label": slider.label, "data-key": slider.key });
  const box = make("input", { type: "number", step: "any", value: rounded6(slider.value), "aria-label": `${slider.label} as a number`, "data-number": slider.key });
  const moved = (from, to) => () => {
    const value = rounded6(from.value);
    if (from.value === "" || !Number.isFinite(value)) return;
    explored.values[slider.key] = value;
    to.value = value;
    planAgain(said);
  };
  input.addEventListener("input", moved(input, box));
  box.addEventListener("change", moved(box, input));
  return make("label", {}, make("span", {}, slider.label), input, make("span", { class: "number" }, box, ` ${slider.unit}`));
}

function choiceRow(name, options, chosen, said) {
  const choice = make("select", { "aria-label": name });
  for (const option of options) choice.append(make("option", { value: option, selected: option === chosen }, option));
  choice.addEventListener("change", () => {
    explored[name] = choice.value;
    planAgain(said);
  });
  return make("label", {}, make("span", {}, name), choice);
}

function rounded6(value) {
  return Number(Number(value).toPrecision(6));
}

showSliders();
