// Apply the light, dark or system theme. Printed pages are always light and state their time and address.

import { byId, forgetColors, setText } from "./dom.js";
import { time } from "./format.js";

const KEY = "solimon-theme";
const THEMES = ["auto", "light", "dark"];

export class Theme {
  /**
   * @param {() => string} addressTheme returns the theme of the address
   * @param {(theme: string) => void} choose
   * @param {() => void} redraw
   */
  constructor(addressTheme, choose, redraw) {
    this.addressTheme = addressTheme;
    this.redraw = redraw;
    byId("theme").addEventListener("click", () => {
      const next = THEMES[(THEMES.indexOf(this.name) + 1) % THEMES.length];
      localStorage.setItem(KEY, next);
      choose(next);
    });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
    addEventListener("beforeprint", () => this.print());
    addEventListener("afterprint", () => this.show());
    matchMedia("print").addEventListener("change", ({ matches }) => (matches ? this.print() : this.show()));
  }

  /** The theme of the address, else the one that this browser remembers. */
  get name() {
    const remembered = this.addressTheme() || localStorage.getItem(KEY) || "";
    return THEMES.includes(remembered) ? remembered : "auto";
  }

  /** Draw everything for paper, before the browser lays out the pages. */
  print() {
    setText(byId("printed"), `Printed ${time(new Date().toISOString())} from ${location.href}`);
    document.documentElement.classList.add("paper");
    this.apply("light");
  }

  show() {
    document.documentElement.classList.remove("paper");
    setText(byId("theme"), `Theme: ${this.name}`);
    this.apply(this.name);
  }

  /** @param {string} name */
  apply(name) {
    if (name === "auto") delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = name;
    forgetColors();
    this.redraw();
  }
}
