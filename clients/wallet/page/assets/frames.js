// Frames of an open clip, fetched a window ahead of where the player is. Must never hold more than its window: a clip of
// 5,000 frames takes no more memory than one of 50.

import { getBytes } from "./api.js";

const KEPT_MAX_COUNT = 48;
const AHEAD_COUNT = 16;
const AT_ONCE_COUNT = 4;

export class FrameWindow {
  /** `clip` as the wallet's program describes it; `frames` in the order in which they are played. */
  constructor(clip, frames, signal) {
    this.clip = clip;
    this.frames = frames;
    this.signal = signal;
    this.onlyOwner = false;
    this.kept = new Map();
    this.waiting = new Map();
    this.next = [];
  }

  /** Show the room behind the owner, or the owner alone. */
  setOnlyOwner(isOnly) {
    this.onlyOwner = isOnly;
    this.kept.forEach((one) => one.bitmap?.close());
    this.kept.clear();
    this.waiting.clear();
  }

  /** Return a frame's content: {depth, width, height, isAlone} | {bitmap} | {label} | {sound: Blob} | {nothing: status}. */
  async at(place) {
    const content = await this.#fetch(place);
    this.next = [];
    for (let ahead = place + 1; ahead < Math.min(this.frames.length, place + AHEAD_COUNT); ahead += 1) if (!this.kept.has(ahead) && !this.waiting.has(ahead)) this.next.push(ahead);
    this.#fill();
    return content;
  }

  /** How many contents are held at this moment. */
  get size() {
    return this.kept.size;
  }

  /** Let everything go. */
  clear() {
    this.next = [];
    this.kept.forEach((one) => one.bitmap?.close());
    this.kept.clear();
  }

  #fill() {
    while (this.waiting.size < AT_ONCE_COUNT && this.next.length > 0) {
      const place = this.next.shift();
      this.#fetch(place).then(() => this.#fill(), () => {});
    }
  }

  async #fetch(place) {
    const known = this.kept.get(place);
    if (known) {
      this.kept.delete(place);
      this.kept.set(place, known);
      return known;
    }
    if (!this.waiting.has(place)) this.waiting.set(place, this.#load(place, this.onlyOwner));
    return this.waiting.get(place);
  }

  async #load(place, onlyOwner) {
    try {
      const content = await this.#read(this.frames[place], onlyOwner);
      if (onlyOwner === this.onlyOwner) this.#keep(place, content);
      return content;
    } finally {
      if (onlyOwner === this.onlyOwner) this.waiting.delete(place);
    }
  }

  #keep(place, content) {
    this.kept.set(place, content);
    while (this.kept.size > KEPT_MAX_COUNT) {
      const [oldest, gone] = this.kept.entries().next().value;
      this.kept.delete(oldest);
      gone.bitmap?.close();
    }
  }

  async #read(frame, onlyOwner) {
    if (frame.status !== "ok") return { nothing: frame.status };
    const path = `clips/${this.clip.clip}/frames/${frame.number}`;
    if (frame.kind === "depth") {
      const { bytes, headers } = await getBytes(`${path}/depth`, { own: onlyOwner ? 1 : undefined }, this.signal);
      return { depth: new Uint16Array(bytes), width: Number(headers.get("X-BlockRobot-Width")), height: Number(headers.get("X-BlockRobot-Height")), isAlone: onlyOwner };
    }
    const { bytes, headers } = await getBytes(`${path}/file`, {}, this.signal);
    const type = headers.get("Content-Type") ?? "";
    if (frame.kind === "label") return { label: JSON.parse(new TextDecoder().decode(bytes)) };
    if (frame.kind === "sound") return { sound: new Blob([bytes], { type: "audio/wav" }) };
    return { bitmap: await createImageBitmap(new Blob([bytes], { type })) };
  }
}
