// Pause and resume the test: a button that asks for the reason, and a banner while nothing strikes.

import { askConfirmation } from "./control/confirm.js";
import { isAllowed } from "./control/session.js";
import { byId, setText } from "./dom.js";
import { icon } from "./icons.js";
import { sendByButton } from "./commands.js";

export class PauseControl {
  /** @param {(text: string) => void} onTrouble */
  constructor(onTrouble) {
    this.onTrouble = onTrouble;
    this.button = /** @type {HTMLButtonElement} */ (byId("pause"));
    this.banner = byId("paused");
    this.resumeButton = /** @type {HTMLButtonElement} */ (byId("resume"));
    byId("paused-icon").append(icon("pause"));
    this.button.addEventListener("click", () => void this.pause());
    this.resumeButton.addEventListener("click", () => void this.resume());
  }

  /** @param {string | null} pausedBy who has paused the test and the reason @param {string} recorder */
  update(pausedBy, recorder) {
    const acceptsCommands = recorder !== "finished" && recorder !== "stopped";
    this.banner.hidden = pausedBy === null;
    this.button.hidden = pausedBy !== null || !acceptsCommands || !isAllowed("pause");
    this.resumeButton.hidden = !acceptsCommands || !isAllowed("resume");
    setText(byId("paused-reason"), pausedBy === null ? "" : `${pausedBy[0].toUpperCase()}${pausedBy.slice(1)}`);
  }

  async pause() {
    const answers = await askConfirmation({
      title: "Pause the test",
      paragraphs: [
        "The current strike ends and no other follows, also after a restart. Due sets are missed.",
        "Pausing does not isolate energy. Open the cut-out before you reach in.",
      ],
      submitLabel: "Pause test",
      // To pause is the safe choice itself: the field that it needs has the focus.
      fields: [
        {
          name: "note",
          label: "Reason",
          first: true,
          input: { required: true, pattern: ".*\\S.*", placeholder: "work inside the rig" },
        },
      ],
    });
    if (answers) await sendByButton(this.button, "pause", answers, this.onTrouble);
  }

  async resume() {
    const answers = await askConfirmation({
      title: "Resume the test",
      paragraphs: [
        "Strikers move again from the next due set. Keep hands out of the rig and close its doors.",
        "To undo it, pause the test again.",
      ],
      submitLabel: "Resume test",
    });
    if (answers) await sendByButton(this.resumeButton, "resume", {}, this.onTrouble);
  }
}
