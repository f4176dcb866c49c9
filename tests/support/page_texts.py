"""The texts that a page draws on its plots: those that lie on each other or are cut off, after any number of redraws."""

from tests.support.browser import Opened

# Before the page is read: every canvas keeps the texts that stand on it, as boxes [px] in its own pixels.
NOTING = """
const { fillText, clearRect } = CanvasRenderingContext2D.prototype;
CanvasRenderingContext2D.prototype.clearRect = function (x, y, w, h) {
  if (w >= this.canvas.width && h >= this.canvas.height) this.canvas.texts = [];
  clearRect.call(this, x, y, w, h);
};
CanvasRenderingContext2D.prototype.fillText = function (text, x, y, ...more) {
  const size = this.measureText(text);
  const corners = [
    [x - size.actualBoundingBoxLeft, y - size.actualBoundingBoxAscent],
    [x + size.actualBoundingBoxRight, y + size.actualBoundingBoxDescent],
  ].map(([a, b]) => this.getTransform().transformPoint(new DOMPoint(a, b)));
  const ends = (key) => corners.map((corner) => corner[key]).sort((a, b) => a - b);
  (this.canvas.texts ??= []).push({ text, x: ends("x"), y: ends("y") });
  fillText.call(this, text, x, y, ...more);
};
"""
_FAULTS = """() => [...document.querySelectorAll(".uplot canvas")].flatMap((canvas) => {
  const title = canvas.closest("figure").querySelector("figcaption").innerText;
  const texts = (canvas.texts ?? []).filter((one) => one.text.trim());
  if (!texts.length) return [`${title}: no text`];
  const [wide, high] = [canvas.width + 1, canvas.height + 1];
  const cut = texts.filter((one) => one.x[0] < -1 || one.y[0] < -1 || one.x[1] > wide || one.y[1] > high);
  const meets = (one, other) => ["x", "y"].every((key) => one[key][0] < other[key][1] && other[key][0] < one[key][1]);
  const on = texts.flatMap((one, k) => texts.slice(k + 1).filter((other) => meets(one, other))
    .map((other) => `${title}: '${one.text}' lies on '${other.text}'`));
  return [...cut.map((one) => `${title}: '${one.text}' is cut off`), ...on];
})"""


def text_faults(opened: Opened) -> list[str]:
    """Return a sentence on each text of a plot that is cut off, lies on another one, or on each plot without texts."""
    return opened.ask(_FAULTS)
