// Asks for the picture that is wanted: once it stays the same for a moment, and again while the service still
// reads sets or new ones have come.

import { fieldsOf } from "./marks.js";
import { greatestOf, readPicture } from "./image.js";

/** @typedef {import("./image.js").Picture} Picture */
/**
 * @typedef {object} Question
 * @property {string} position
 * @property {string} method
 * @property {Record<string, any>} query of /waterfall
 * @property {string} without why there is nothing to ask for; empty: it is asked
 */

const READ_MS = 120;
const GO_ON_MS = 400;

export class PictureReading {
  /**
   * @param {() => Question | null} wanted null: nothing is known of the position yet
   * @param {(position: string, fields: string[], range: Record<string, number>) => Promise<any>} trend
   * @param {() => void} onRead
   */
  constructor(wanted, trend, onRead) {
    this.wanted = wanted;
    this.trend = trend;
    this.onRead = onRead;
    /** @type {Picture | null} */
    this.picture = null;
    /** Columns of /trends beside it. @type {Record<string, any[]>} */
    this.columns = {};
    /** Its greatest magnitude. */
    this.limit = 0;
    this.trouble = "";
    /** The question that was answered last. */
    this.asked = "";
    /** Sets that the picture before lacked. */
    this.pending = Infinity;
    /** What there is of the position: a picture of less is asked for again. */
    this.newest = "";
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    this.timer = undefined;
  }

  /** Whether what is wanted is what is here. */
  get settled() {
    return this.picture !== null && this.asked === this.question();
  }

  question() {
    return JSON.stringify([this.wanted(), this.newest]);
  }

  /** Something may be new. @param {string} newest what there is of the position */
  renew(newest) {
    this.newest = newest;
    if (this.trouble) this.asked = "";
  }

  schedule(ms = READ_MS) {
    if (this.timer !== undefined) return;
    this.timer = setTimeout(async () => {
      // Another question, or the first: whatever waits is gone on with.
      this.pending = this.asked === "" ? (this.picture?.header.pending_sets ?? Infinity) : Infinity;
      await this.read();
      const left = this.picture?.header.pending_sets ?? 0;
      this.timer = undefined;
      if (this.wanted() === null) return;
      if (this.asked !== this.question()) this.schedule();
      else if (left > 0 && left < this.pending) {
        // Sets without tiles are read some at a time, as long as they get fewer: the service's memory has an end.
        this.asked = "";
        this.schedule(GO_ON_MS);
      }
    }, ms);
  }

  async read() {
    const question = this.question();
    const wanted = this.wanted();
    if (question === this.asked || wanted === null) return;
    const { position, method, query, without } = wanted;
    try {
      if (without) throw new Error(without);
      const [picture, { columns }] = await Promise.all([readPicture(position, query), this.trend(position, fieldsOf(method), { from_h: query.from_h, to_h: query.to_h })]);
      if (position !== this.wanted()?.position) return;
      Object.assign(this, { picture, columns, limit: greatestOf(picture), trouble: "" });
    } catch (error) {
      this.trouble = /** @type {Error} */ (error).message;
      this.picture = null;
    }
    this.asked = question;
    this.onRead();
  }
}
