// Announce alarms on a wall screen, if asked to: sound until silenced or acknowledged, and browser notifications.

import { button, setText } from "./dom.js";

const KEY = "solimon-sound";
const REPEAT_MS = 4000;
const TONES_HZ = [880, 660];
const TONE_S = 0.25;

/** Alarms that sound: active, unacknowledged and not suppressed. @param {any} alarm */
const sounds = (alarm) => alarm.state === "unacknowledged" && !alarm.suppressed;
/** @param {any} alarm */
const keyOf = (alarm) => `${alarm.id} ${alarm.priority}`;

export class Announcer {
  constructor() {
    this.on = localStorage.getItem(KEY) === "on";
    /** @type {AudioContext | null} */
    this.audio = null;
    /** Alarms that sound, with their priority. @type {Set<string>} */
    this.active = new Set();
    /** Those that a person silenced, which acknowledges nothing. @type {Set<string>} */
    this.silenced = new Set();
    this.started = false;
    this.toggle = button("", () => void this.switch(), { "data-focus": "sound" });
    this.silence = button("Silence", () => this.silenceAll(), { hidden: true, "data-focus": "silence" });
    setInterval(() => this.sound(), REPEAT_MS);
    // A browser plays no sound before a click or a key, also after a reload.
    for (const gesture of ["pointerdown", "keydown"]) addEventListener(gesture, () => this.open());
    this.show();
  }

  async switch() {
    this.on = !this.on;
    localStorage.setItem(KEY, this.on ? "on" : "off");
    if (this.on && isSecureContext && "Notification" in window) await Notification.requestPermission();
    this.open();
    this.show();
    this.sound();
  }

  open() {
    if (!this.on) return;
    this.audio ??= new AudioContext();
    if (this.audio.state !== "running") void this.audio.resume().then(() => (this.show(), this.sound()));
  }

  silenceAll() {
    this.silenced = new Set(this.active);
    this.show();
  }

  /** @param {any[]} alarms all of the test */
  update(alarms) {
    const sounding = alarms.filter(sounds);
    const before = this.active;
    this.active = new Set(sounding.map(keyOf));
    this.silenced = new Set([...this.silenced].filter((key) => this.active.has(key)));
    const added = sounding.filter((alarm) => !before.has(keyOf(alarm)));
    if (this.started && this.on && added.length) {
      if ("Notification" in window && Notification.permission === "granted")
        for (const alarm of added)
          new Notification(`[${alarm.priority.toUpperCase()}] ${alarm.headline} - ${document.title}`, {
            body: alarm.message,
            tag: keyOf(alarm),
          });
      this.sound();
    }
    this.started = true;
    this.show();
  }

  /** Whether an alarm sounds that is not silenced. */
  get loud() {
    return this.on && [...this.active].some((key) => !this.silenced.has(key));
  }

  sound() {
    const { audio } = this;
    if (!this.loud || audio?.state !== "running") return;
    TONES_HZ.forEach((frequency, k) => {
      const tone = new OscillatorNode(audio, { frequency });
      tone.connect(new GainNode(audio, { gain: 0.2 })).connect(audio.destination);
      tone.start(audio.currentTime + k * TONE_S);
      tone.stop(audio.currentTime + (k + 1) * TONE_S);
    });
  }

  show() {
    const waits = this.on && this.audio?.state !== "running" ? ": click once to start" : "";
    const name = isSecureContext ? "Sound and notifications" : "Sound (notifications need HTTPS or localhost)";
    setText(this.toggle, `${name}${waits}`);
    this.toggle.setAttribute("aria-pressed", String(this.on));
    this.silence.hidden = !this.loud;
  }
}
