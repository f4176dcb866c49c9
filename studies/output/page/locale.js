// Browsers that start without a locale, as in containers, report "en-US@posix". uPlot passes the language on to Intl, which
// refuses such a tag, and no plot would be drawn.
try {
  new Intl.NumberFormat(navigator.language);
} catch {
  Object.defineProperty(navigator, "language", { value: "en-US" });
}
