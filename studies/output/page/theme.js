// Light and dark: as the system has it, until the switch says otherwise.

const theme = {
  listeners: [],
  /** Return the value of a colour of the style sheet, "ink" or "c0" say. */
  colour(name) {
    return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  },
  /** Return the name of a series's colour; those beyond the seventh begin again. */
  named(index) {
    return index === null || index === undefined ? "ink" : `c${index % 7}`;
  },
  /** Return a series's colour. */
  series(index) {
    return theme.colour(theme.named(index));
  },
  dark() {
    const chosen = document.documentElement.dataset.theme;
    return chosen ? chosen === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  },
  set(name) {
    if (name) document.documentElement.dataset.theme = name;
    else delete document.documentElement.dataset.theme;
    theme.changed();
  },
  changed() {
    for (const listener of theme.listeners) listener();
  },
};
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", theme.changed);

/** Return the dashes of a look: lines are told apart by them where colours begin again. */
function dashes(look) {
  return { dash: [8, 5], dots: [2, 4], dashdot: [8, 4, 2, 4] }[look] || [];
}
