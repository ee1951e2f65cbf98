// Asks for what is drawn first while the page's other modules are still on their way. What fails here is asked
// for again, and told, by those who need it.

import { ahead } from "./api.js";

try {
  const { role } = await ahead("/api/v1/session");
  if (role !== null && (await ahead("/healthz")).data) {
    await ahead("/api/v1/info");
    await ahead("/api/v1/transducers");
  }
} catch (error) {
  console.debug("asked for too early:", error);
}
