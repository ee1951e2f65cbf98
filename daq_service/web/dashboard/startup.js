// What is seen first: the tiles, of answers that came with the page. Its other scripts are asked for when these
// are on the screen; before, they would only be in the way.

import { broughtAlong } from "./api.js";
import { byId } from "./dom.js";
import { Tiles } from "./tiles.js";

export const tiles = new Tiles(byId("tiles"));
setInterval(() => tiles.tick(), 1000);
// What is shown stands in the address, which the other scripts read when they come.
/** @param {string} position */
tiles.onSelect = (position) => {
  const query = new URLSearchParams(location.search);
  if (query.get("position") === position) return;
  query.set("position", position);
  for (const name of ["set", "shot", "from_us", "to_us"]) query.delete(name);
  history.replaceState(null, "", `?${query}`);
  tiles.select(position);
};

const transducers = broughtAlong("/api/v1/transducers");
if (transducers) {
  tiles.lossLimit = broughtAlong("/api/v1/info").limits.thickness_loss_fraction;
  tiles.online = true;
  tiles.update(transducers);
}

function goOn() {
  document.head.append(/** @type {HTMLTemplateElement} */ (byId("later")).content);
  void import("./main.js");
}

// A page that nobody looks at has no frames.
if (document.hidden) goOn();
else requestAnimationFrame(() => setTimeout(goOn));
