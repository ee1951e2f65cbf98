// Log in: where the service needs a token, nothing else starts before the page has one.

import { get, post, remove } from "./api.js";
import { byId, el, setText } from "./dom.js";

/** @typedef {import("./control/session.js").Session} Session */

/** Wait until this page may read. The token becomes a cookie that no script can read. @returns {Promise<Session>} */
export async function waitForLogin() {
  /** @type {Session} */
  let session = await get("/session");
  if (session.role === null) session = await loggedIn();
  const button = byId("log-out");
  if (!session.token_needed) return session;
  setText(button, `Log out ${session.name} (${session.role})`);
  button.hidden = false;
  button.addEventListener("click", async () => {
    await remove("/session");
    location.reload();
  });
  return session;
}

/** @returns {Promise<Session>} */
function loggedIn() {
  const token = /** @type {HTMLInputElement} */ (
    el("input", {
      id: "login-token",
      class: "field",
      type: "password",
      maxlength: "200",
      autocomplete: "off",
      required: true,
    })
  );
  const trouble = el("p", { id: "login-trouble", role: "alert" });
  const form = el(
    "form",
    {},
    el("h2", { id: "login-title", text: "Log in" }),
    el(
      "p",
      { class: "quiet" },
      "This service needs a token. Its administrator creates one with ",
      el("code", { text: "solimon token create" }),
      ".",
    ),
    el("label", { for: "login-token", text: "Token" }),
    token,
    trouble,
    el("div", { class: "dialog-actions" }, el("button", { class: "button", type: "submit", text: "Log in" })),
  );
  const dialog = /** @type {HTMLDialogElement} */ (el("dialog", { "aria-labelledby": "login-title" }, form));
  dialog.addEventListener("cancel", (event) => event.preventDefault());
  document.body.append(dialog);
  dialog.showModal();
  token.focus();
  return new Promise((resolve) => {
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      try {
        const session = await post("/session", { token: token.value.trim() });
        dialog.remove();
        resolve(session);
      } catch (error) {
        setText(trouble, /** @type {Error} */ (error).message);
        token.select();
      }
    });
  });
}
