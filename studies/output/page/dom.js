// Elements and texts. Whatever comes from the document goes in as text, never as markup.

/** Return an element with attributes and children; text children become text nodes. */
function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value !== false && value !== null) element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.filter((child) => child !== null));
  return element;
}

/** Return a number as people read it: up to `digits` digits, no trailing zeros. */
function said(value, digits = 5) {
  if (value === null || value === undefined) return "–";
  if (!Number.isFinite(value)) return String(value);
  if (Number.isInteger(value) && Math.abs(value) < 1e7) return String(value);
  const size = Math.abs(value);
  if (size < 1e-4 || size >= 1e7) return value.toExponential(digits - 1).replace(/\.?0+e/, "e").replace("e+", "e");
  return String(Number(value.toPrecision(digits)));
}

/** Return a quantity with its unit, "1" for none. */
function withUnit(text, unit) {
  return unit && unit !== "1" ? `${text} ${unit}` : text;
}

/** Return an axis's label with its unit in brackets. */
function labelled(axis) {
  return axis.unit && axis.unit !== "1" ? `${axis.label} [${axis.unit}]` : axis.label;
}

/** Call `build` once: when an element first comes near the window, when the browser is idle, or before the page is printed.
 *
 * What is folded waits until it is opened. A picture of the whole page, as tools take it without scrolling, has every plot.
 */
function whenSeen(element, build) {
  let built = false;
  const once = () => {
    if (built) return;
    built = true;
    watcher.disconnect();
    build();
  };
  const watcher = new IntersectionObserver((entries) => entries.some((one) => one.isIntersecting) && once(), {
    rootMargin: "400px",
  });
  watcher.observe(element);
  whenSeen.all.push(once);
  const whenIdle = window.requestIdleCallback ?? setTimeout;
  whenIdle(() => element.isConnected && !element.closest("details:not([open])") && once());
}
whenSeen.all = [];

/** Call `fit` when an element's size changes, and before the page is printed, whose layout is set by then. */
function whenSized(element, fit) {
  new ResizeObserver(fit).observe(element);
  whenSized.all.push(fit);
}
whenSized.all = [];
