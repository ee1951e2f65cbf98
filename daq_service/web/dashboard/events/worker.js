// Shared by all tabs of a browser that show the same test: one connection for them together, since a browser opens no more than
// six to a service and the tabs beyond would wait for ever.

import { Source } from "./source.js";

const KEPT = 2000;

/** Who listens, and whether somebody looks at it. @type {Map<MessagePort, boolean>} */
const ports = new Map();
/** News for a tab that comes later: all ids above `since`. @type {import("./source.js").News[]} */
let kept = [];
let since = 0;
/** @type {Source | null} */
let source = null;

/** @param {object} message */
function tell(message) {
  for (const port of ports.keys()) port.postMessage(message);
}

/** @param {MessagePort} port @param {number} after @param {string} base where the test is */
function join(port, after, base) {
  if (source === null) {
    since = after;
    source = new Source(after, {
      onNews: (news) => {
        kept.push(news);
        if (kept.length > KEPT) since = kept.splice(0, KEPT / 2).at(-1)?.id ?? since;
        tell({ news });
      },
      onGap: (id) => {
        kept = [];
        since = id;
        tell({ gap: id });
      },
      onState: (open) => tell({ open, intervalS: source?.watch.intervalS }),
    }, base);
    return;
  }
  // After a sleep of the computer: what was open may be dead.
  source.watch.look();
  if (after < since) port.postMessage({ gap: source.lastId });
  else for (const news of kept) if (news.id > after) port.postMessage({ news });
  port.postMessage({ open: source.isOpen });
}

globalThis.addEventListener("connect", (event) => {
  const [port] = /** @type {MessageEvent} */ (event).ports;
  port.onmessage = ({ data: { leave, awake, after, base } }) => {
    if (leave) ports.delete(port);
    else ports.set(port, awake);
    if (after !== undefined) join(port, after, base);
    if (ports.size) source?.wake([...ports.values()].some(Boolean));
  };
});
