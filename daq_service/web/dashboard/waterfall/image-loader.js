// Load the image of the current view: once the view is stable for a moment, and again while the service
// still reads sets or new ones have arrived.

import { fieldsOf } from "./marks.js";
import { largestMagnitude, readImage } from "./image.js";

/** @typedef {import("./image.js").WaterfallImage} WaterfallImage */
/**
 * @typedef {object} Question
 * @property {string} position
 * @property {string} method
 * @property {Record<string, any>} query of /waterfall
 * @property {string} missingReason why there is nothing to load; empty: it is loaded
 */

const READ_MS = 120;
const GO_ON_MS = 400;

export class ImageLoader {
  /**
   * @param {() => Question | null} currentQuestion null: the position is not known yet
   * @param {(position: string, fields: string[], range: Record<string, number>) => Promise<any>} trend
   * @param {() => void} onRead
   */
  constructor(currentQuestion, trend, onRead) {
    this.currentQuestion = currentQuestion;
    this.trend = trend;
    this.onRead = onRead;
    /** @type {WaterfallImage | null} */
    this.image = null;
    /** Columns of /trends for the same hours. @type {Record<string, any[]>} */
    this.columns = {};
    /** Its maximum magnitude. */
    this.limit = 0;
    this.trouble = "";
    /** The question of the last answer. */
    this.answeredQuestion = "";
    /** Sets that the previous image lacked. */
    this.pending = Infinity;
    /** Newest data of the position: an image with less is loaded again. */
    this.newest = "";
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    this.timer = undefined;
  }

  /** Whether the loaded image is the wanted one. */
  get settled() {
    return this.image !== null && this.answeredQuestion === this.question();
  }

  question() {
    return JSON.stringify([this.currentQuestion(), this.newest]);
  }

  /** Check for newer data. @param {string} newest newest data of the position */
  renew(newest) {
    this.newest = newest;
    if (this.trouble) this.answeredQuestion = "";
  }

  schedule(ms = READ_MS) {
    if (this.timer !== undefined) return;
    this.timer = setTimeout(async () => {
      // Another question, or the first: load all pending sets.
      this.pending = this.answeredQuestion === "" ? (this.image?.header.pending_sets ?? Infinity) : Infinity;
      await this.read();
      const pendingSets = this.image?.header.pending_sets ?? 0;
      this.timer = undefined;
      if (this.currentQuestion() === null) return;
      if (this.answeredQuestion !== this.question()) this.schedule();
      else if (pendingSets > 0 && pendingSets < this.pending) {
        // Sets without tiles are read in parts, as long as they get fewer: the service's memory is limited.
        this.answeredQuestion = "";
        this.schedule(GO_ON_MS);
      }
    }, ms);
  }

  async read() {
    const question = this.question();
    const currentQuestion = this.currentQuestion();
    if (question === this.answeredQuestion || currentQuestion === null) return;
    const { position, method, query, missingReason: without } = currentQuestion;
    try {
      if (without) throw new Error(without);
      const [image, { columns }] = await Promise.all([
        readImage(position, query),
        this.trend(position, fieldsOf(method), { from_h: query.from_h, to_h: query.to_h }),
      ]);
      if (position !== this.currentQuestion()?.position) return;
      Object.assign(this, { image, columns, limit: largestMagnitude(image), trouble: "" });
    } catch (error) {
      this.trouble = /** @type {Error} */ (error).message;
      this.image = null;
    }
    this.answeredQuestion = question;
    this.onRead();
  }
}
