// One connection, shared by all tabs of a browser that show the same test: a browser opens at most
// six to a service, and further tabs would never get one.

import { Source } from "./source.js";

const MAX_KEPT = 2000;

/** Pages that listen, and whether each is visible. @type {Map<MessagePort, boolean>} */
const ports = new Map();
/** Events for a tab that connects later: all ids above `keptAfter`. @type {import("./source.js").StreamEvent[]} */
let kept = [];
let keptAfter = 0;
/** @type {Source | null} */
let source = null;

/** @param {object} message */
function broadcast(message) {
  for (const port of ports.keys()) port.postMessage(message);
}

/** @param {MessagePort} port @param {number} after @param {string} base path of the test */
function join(port, after, base) {
  if (source === null) {
    keptAfter = after;
    source = new Source(
      after,
      {
        onEvent: (news) => {
          kept.push(news);
          if (kept.length > MAX_KEPT) keptAfter = kept.splice(0, MAX_KEPT / 2).at(-1)?.id ?? keptAfter;
          broadcast({ news });
        },
        onGap: (id) => {
          kept = [];
          keptAfter = id;
          broadcast({ gap: id });
        },
        onState: (open) => broadcast({ open, intervalS: source?.monitor.intervalS }),
      },
      base,
    );
    return;
  }
  // After a sleep of the computer an open connection may be dead.
  source.monitor.check();
  if (after < keptAfter) port.postMessage({ gap: source.lastId });
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
