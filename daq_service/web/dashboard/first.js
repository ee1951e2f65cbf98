// What is seen first: the tiles, while the page's other modules are still on their way. What fails here is asked
// for again, and told, by those who need it.

import { ahead } from "./api.js";
import { byId } from "./dom.js";
import { Tiles } from "./tiles.js";

export const tiles = new Tiles(byId("tiles"));
setInterval(() => tiles.tick(), 1000);

async function begin() {
  const [{ role }, { data }] = await Promise.all([ahead("/api/v1/session"), ahead("/healthz")]);
  if (role === null || !data) return;
  // One after the other: what changes behind the events that the first counts is read again.
  tiles.lossLimit = (await ahead("/api/v1/info")).limits.thickness_loss_fraction;
  tiles.online = true;
  tiles.update(await ahead("/api/v1/transducers"));
}

begin().catch((error) => console.debug("asked for too early:", error));
