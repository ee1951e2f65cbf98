// Build elements without markup strings: nothing read from the service is parsed as HTML.

/**
 * @param {string} tag
 * @param {Record<string, string | boolean>} [attributes] `text` sets the content
 * @param {...(Node | string)} children
 * @returns {HTMLElement}
 */
export function el(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [key, value] of Object.entries(attributes)) {
    if (key === "text") element.textContent = String(value);
    else if (value === true) element.setAttribute(key, "");
    else if (value !== false) element.setAttribute(key, String(value));
  }
  element.append(...children);
  return element;
}

/**
 * Return a small button.
 *
 * @param {string} text
 * @param {(button: HTMLButtonElement) => void} act
 * @param {Record<string, string | boolean>} [attributes]
 */
export function button(text, act, attributes = {}) {
  const made = /** @type {HTMLButtonElement} */ (
    el("button", { class: "button ghost small", type: "button", text, ...attributes })
  );
  made.addEventListener("click", () => act(made));
  return made;
}

/** @param {string} id @returns {HTMLElement} */
export function byId(id) {
  const element = document.getElementById(id);
  if (!element) throw new Error(`the page has no #${id}`);
  return element;
}

/** Set a text only when it changes, so that screen readers stay quiet. @param {Element} element @param {string} text */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Colors of the current theme: to compute one takes longer than to draw with it. @type {Map<string, string>} */
const colors = new Map();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => forgetColors());

/** @param {string} name of a custom property, e.g. --data @returns {string} */
export function color(name) {
  let found = colors.get(name);
  if (!found) colors.set(name, (found = getComputedStyle(document.documentElement).getPropertyValue(name).trim()));
  return found;
}

/** Forget the colors when another theme is applied. */
export function forgetColors() {
  colors.clear();
}
