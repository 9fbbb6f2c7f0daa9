// What the page asks of the wallet's program, and nothing else. Must never keep a passphrase, nor try one again by itself.

import { ask, h } from "./shared/dom.js";
import { fetchBytes, fetchJson, keepOpen, Problem } from "./shared/fetching.js";
import { language, t } from "./texts.js";

const AGAIN_MS = 700;
const JOB_WAIT_MS = 20_000;
let whenClosed = () => {};
let touchedAt = Date.now();

// What the page asks by itself when news come in is no use of it: each question says how long nobody has touched it.
for (const what of ["pointerdown", "pointermove", "keydown", "wheel", "touchstart"]) {
  window.addEventListener(what, () => { touchedAt = Date.now(); }, { capture: true, passive: true });
}

/** Say what is to happen when the session is over or the program has ended. */
export function onClosed(act) {
  whenClosed = act;
}

function address(path, query = {}) {
  const given = Object.entries(query).filter(([, value]) => value !== undefined && value !== null && value !== "");
  const text = new URLSearchParams(given).toString();
  return `./api/${path}${text ? `?${text}` : ""}`;
}

const pause = (ms) => new Promise((done) => { setTimeout(done, ms); });

async function guarded(work, { again = false } = {}) {
  try {
    return await work();
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    if (error.status === 0 && again) {
      await pause(AGAIN_MS);
      return guarded(work);
    }
    if (error.status === 401 || error.status === 0) whenClosed(error);
    throw error;
  }
}

const headers = () => ({ "Accept-Language": language(), "X-BlockRobot-Quiet-Ms": String(Math.max(0, Date.now() - touchedAt)) });

/** Fetch JSON. Throws a Problem, or AbortError once `signal` says that nobody waits any more. */
export function get(path, query, signal) {
  return guarded(() => fetchJson(address(path, query), { signal, headers: headers() }), { again: true });
}

/** Send JSON. Never sent twice by itself. */
export function post(path, body = {}, signal) {
  return keepOpen(() => guarded(() => fetchJson(address(path), { method: "POST", body, signal, headers: headers() })));
}

/** Have something forgotten; what is gone already is as good. */
export function forget(path) {
  return fetchJson(address(path), { method: "DELETE" }).catch(() => null);
}

/** Fetch bytes: {bytes, headers}. */
export function getBytes(path, query, signal) {
  return guarded(() => fetchBytes(address(path, query), { signal }), { again: true });
}

/** Follow a job to its end: `onChange(job)` at each step. Returns its result; throws its Problem. */
export function follow(job, onChange = () => {}, signal) {
  return keepOpen(() => followToEnd(job, onChange, signal));
}

async function followToEnd(job, onChange, signal) {
  let after;
  for (;;) {
    const state = await get(`jobs/${job}`, { after, wait_ms: after === undefined ? undefined : JOB_WAIT_MS }, signal);
    after = state.revision;
    onChange(state);
    if (state.state === "done") return state.result;
    if (state.state === "cancelled") throw new Problem({ code: "CANCELLED", detail: t("job.cancelled"), nextStep: "", status: 499 });
    if (state.state === "failed") {
      const { code, detail, next_step: nextStep, status } = state.error;
      throw new Problem({ code, detail, nextStep, status });
    }
  }
}

/**
 * Ask for the passphrase and send the body with it; ask again while it is wrong. Returns the answer, null if they let it be.
 */
export function postWithPassphrase(path, body, { title, text, confirm, danger }) {
  return ask({
    title,
    body: h("p", {}, text),
    confirm,
    cancel: t("ask.cancel"),
    danger,
    busy: t("ask.checking"),
    fields: [{ name: "passphrase", label: t("ask.passphrase"), type: "password", required: true, hint: t("ask.why"), autocomplete: "current-password" }],
    attempt: async ({ passphrase }) => {
      try {
        return { answer: await post(path, { ...body, passphrase }) };
      } catch (error) {
        if (!(error instanceof Problem) || !["WALLET_PASSPHRASE_WRONG", "PASSPHRASE_LOCKED"].includes(error.code)) throw error;
        return { refusal: `${error.detail} ${error.nextStep}` };
      }
    },
  });
}
