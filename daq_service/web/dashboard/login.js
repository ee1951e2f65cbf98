// The way in: where the service asks for a token, nothing else begins before the page has one.

import { get, post, remove } from "./api.js";
import { byId, setText } from "./dom.js";

/** @typedef {import("./control/who.js").Session} Session */

/** Ends once this page may read. The token becomes a cookie that no script can read. @returns {Promise<Session>} */
export async function admitted() {
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
  const dialog = /** @type {HTMLDialogElement} */ (byId("login"));
  const token = /** @type {HTMLInputElement} */ (byId("login-token"));
  dialog.addEventListener("cancel", (event) => event.preventDefault());
  dialog.showModal();
  token.focus();
  return new Promise((resolve) => {
    byId("login-form").addEventListener("submit", async (event) => {
      event.preventDefault();
      try {
        const session = await post("/session", { token: token.value.trim() });
        dialog.close();
        resolve(session);
      } catch (error) {
        setText(byId("login-trouble"), /** @type {Error} */ (error).message);
        token.select();
      }
    });
  });
}
