// Light or dark: as the browser says, unless somebody has chosen.

const KEY = "solimon-theme";

export const THEMES = ["auto", "light", "dark"];

/** What this browser remembers. @returns {string} */
export const remembered = () => localStorage.getItem(KEY) ?? "";

/** @param {string} theme */
export const remember = (theme) => localStorage.setItem(KEY, theme);

/** @param {string} theme one of `THEMES`; another means `auto` */
export function showTheme(theme) {
  if (theme === "light" || theme === "dark") document.documentElement.dataset.theme = theme;
  else delete document.documentElement.dataset.theme;
}
