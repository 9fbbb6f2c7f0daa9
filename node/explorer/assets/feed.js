// The newest headers as the node tells them, live. Goes on after a break where it stopped, and keeps 500 of them at most.

import { api, entry } from "./api.js";

export const KEPT_COUNT = 500;
const FIRST_COUNT = 200;
const PAGE_COUNT = 100;
const WAIT_MS = 5_000;
const ANSWER_MS = 10_000; // a node that stands still keeps its connections open and answers nothing
const PAUSE_MS = 200;
const PUBLIC_PAUSE_MS = 1_000;
const RETRY_FIRST_MS = 500;
export const RETRY_MAX_MS = 1_500; // who is back is seen within two seconds, and one question costs a node little
const BUSY_RETRY_MAX_MS = 10_000; // one that asked for less is asked less

/** Return what tells how long ago this was, ms. One clock stands still while the machine sleeps, the other can be set back. */
function clocksFromNow() {
  const [steadyMs, wallMs] = [performance.now(), Date.now()];
  return () => Math.max(performance.now() - steadyMs, Date.now() - wallMs);
}

/** Tell whether nobody answers, or `blockrobot explore` says so of the node. */
export function isAway(problem) {
  return problem?.status === 0 || problem?.code === "NODE_UNREACHABLE";
}

class Feed extends EventTarget {
  headers = [];
  status = null;
  problem = null;
  /** How long the pause before the next try is, ms; 0 while all is well. */
  retryMs = 0;
  #isRunning = false;
  #readClocks = clocksFromNow();
  #wake = () => {};

  /** The height of the newest header that is here; -1 if there is none. */
  get last() {
    return this.headers.at(-1)?.height ?? -1;
  }

  at(height) {
    const first = this.headers[0]?.height ?? 0;
    return this.headers[height - first] ?? null;
  }

  /** The node's clock now, as far as can be told from its last word, ms. */
  get nodeNowMs() {
    return this.status ? this.status.now_ms + this.#readClocks() : Date.now();
  }

  /** Tell whether the node does not answer at all. */
  get isAway() {
    return isAway(this.problem);
  }

  /** Tell whether the session is over: nothing comes in until there is another. */
  get isOver() {
    return this.problem?.status === 401 || this.problem?.status === 403;
  }

  /** Follow the chain until the page is closed or the session is over; may be called again then. One loop runs at a time. */
  async run() {
    if (this.#isRunning) return;
    this.#isRunning = true;
    try {
      await this.#follow();
    } finally {
      this.#isRunning = false;
    }
  }

  async #follow() {
    const chain = this.status?.chain_id;
    let retryMs = RETRY_FIRST_MS;
    for (;;) {
      try {
        const waitMs = this.problem ? 0 : WAIT_MS; // after a break any answer is news: no new block is waited for
        await this.ask(waitMs);
        if (chain && this.status.chain_id !== chain) {
          location.reload(); // another network answers here now: nothing of the former is true of it
          return;
        }
        await this.catchUp();
        this.#tell(null, 0);
        retryMs = RETRY_FIRST_MS;
        await this.#pause(entry.kind === "member" ? PAUSE_MS : PUBLIC_PAUSE_MS);
      } catch (problem) {
        this.#tell(problem, retryMs);
        if (this.isOver) return;
        await this.#pause(retryMs);
        retryMs = Math.min(2 * retryMs, problem.code === "RATE_LIMITED" ? BUSY_RETRY_MAX_MS : RETRY_MAX_MS);
      }
    }
  }

  /** Ask how the node is, at once or when there is a newer block. */
  async ask(waitMs = 0) {
    this.status = await api.status(this.last, waitMs, AbortSignal.timeout(waitMs + ANSWER_MS));
    this.#readClocks = clocksFromNow();
  }

  /** Try again now: the browser has its network again, or somebody looks at the page again. A busy node is asked no sooner. */
  tryNow() {
    if (this.isAway && !document.hidden) this.#wake();
  }

  #pause(ms) {
    return new Promise((resolve) => {
      this.#wake = resolve;
      setTimeout(resolve, ms);
    });
  }

  /** Read on from the last header; what lies farther back than is kept is left out. */
  async catchUp() {
    const head = this.status.head;
    const least = this.headers.length ? head - KEPT_COUNT + 1 : head - FIRST_COUNT + 1;
    if (this.last + 1 < least) this.headers = [];
    let next = Math.max(0, this.last + 1, least);
    while (next <= head) {
      const answer = await api.headers(next, PAGE_COUNT, AbortSignal.timeout(ANSWER_MS));
      if (!answer.headers.length) return;
      this.headers.push(...answer.headers);
      this.headers.splice(0, this.headers.length - KEPT_COUNT);
      next = this.last + 1;
    }
  }

  /** Fill up to the number that is kept with older headers. */
  async fill() {
    while (this.headers.length && this.headers.length < KEPT_COUNT && this.headers[0].height > 0) {
      const first = this.headers[0].height;
      const from = Math.max(0, first - PAGE_COUNT, this.last - KEPT_COUNT + 1);
      const answer = await api.headers(from, first - from);
      if (!answer.headers.length || this.headers[0]?.height !== first) return;
      this.headers.unshift(...answer.headers);
      this.headers.splice(0, this.headers.length - KEPT_COUNT);
    }
  }

  /** Call `listener` now and after each change, until `signal` is aborted. */
  follow(listener, signal) {
    this.addEventListener("change", listener, { signal });
    if (this.status) listener();
  }

  #tell(problem, retryMs) {
    this.problem = problem;
    this.retryMs = retryMs;
    this.dispatchEvent(new Event("change"));
  }
}

export const feed = new Feed();
