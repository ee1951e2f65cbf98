// Draw the tiles first, from answers embedded in the page. The other scripts are requested when these
// are on the screen; before that they would only delay them.

import { embeddedAnswer } from "./api.js";
import { byId } from "./dom.js";
import { Tiles } from "./tiles.js";

// An embedded page shows one panel of the charts' grid.
const shown = new URLSearchParams(location.search);
if (shown.get("embed") === "1") {
  const panel = document.getElementById(shown.get("panel") ?? "");
  document.body.dataset.embed = "1";
  (panel?.parentElement?.id === "charts" ? panel : byId("chart")).classList.add("embedded");
}

export const tiles = new Tiles(byId("tiles"));
setInterval(() => tiles.tick(), 1000);
// The address holds the view; the other scripts read it when they load.
/** @param {string} position */
tiles.onSelect = (position) => {
  const query = new URLSearchParams(location.search);
  if (query.get("position") === position) return;
  query.set("position", position);
  for (const name of ["set", "shot", "from_us", "to_us"]) query.delete(name);
  history.replaceState(null, "", `?${query}`);
  tiles.select(position);
};

const transducers = embeddedAnswer("/api/v1/transducers");
if (transducers) {
  tiles.setLimits(embeddedAnswer("/api/v1/info"));
  tiles.online = true;
  tiles.update(transducers);
}

function loadRemaining() {
  document.head.append(/** @type {HTMLTemplateElement} */ (byId("later")).content);
  void import("./main.js");
}

// A hidden page has no frames.
if (document.hidden) loadRemaining();
else requestAnimationFrame(() => setTimeout(loadRemaining));
