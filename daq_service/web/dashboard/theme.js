// Light, dark, or as the computer has it. Paper is light whatever the screen is, and says when and from where it came.

import { byId, forgetColors, setText } from "./dom.js";
import { utc } from "./format.js";

const KEY = "solimon-theme";
const THEMES = ["auto", "light", "dark"];

export class Theme {
  /** @param {() => string} asked theme of the address @param {(theme: string) => void} choose @param {() => void} redraw */
  constructor(asked, choose, redraw) {
    this.asked = asked;
    this.redraw = redraw;
    byId("theme").addEventListener("click", () => {
      const next = THEMES[(THEMES.indexOf(this.name) + 1) % THEMES.length];
      localStorage.setItem(KEY, next);
      choose(next);
    });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
    addEventListener("beforeprint", () => {
      setText(byId("printed"), `Printed ${utc(new Date().toISOString())} from ${location.href}`);
      this.wear("light");
    });
    addEventListener("afterprint", () => this.show());
  }

  /** The theme of the address, else what this browser remembers. */
  get name() {
    const remembered = this.asked() || localStorage.getItem(KEY) || "";
    return THEMES.includes(remembered) ? remembered : "auto";
  }

  show() {
    setText(byId("theme"), `Theme: ${this.name}`);
    this.wear(this.name);
  }

  /** @param {string} name */
  wear(name) {
    if (name === "auto") delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = name;
    forgetColors();
    this.redraw();
  }
}
