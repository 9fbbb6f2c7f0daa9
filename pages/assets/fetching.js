// Asks the server that served the page, and nobody else. The session's secret lives in this module's memory alone.

const SESSION_HEADER = "X-BlockRobot-Session";
let session = "";

/**
 * A refusal: `code`, `detail` (what happened) and `nextStep` (what the reader can do). `status` 0: nobody answered.
 * `command`: what opens the page again, for who shows a link of it.
 */
export class Problem extends Error {
  constructor({ code, detail, nextStep, status, command }) {
    super(detail);
    this.name = "Problem";
    Object.assign(this, { code, detail, nextStep, status, command });
  }
}

/** Take the secret out of the address, before anything else can see it. */
export function takeFragment() {
  const fragment = location.hash.slice(1);
  history.replaceState(history.state, "", location.pathname + location.search);
  return fragment;
}

/** Exchange the one-time token of the link for a session. Throws PAGE_LINK_INVALID. */
export async function openSession(path = "./session") {
  const answer = await fetchJson(path, { method: "POST", body: { token: takeFragment() } });
  session = answer.session;
  return answer;
}

/** Tell whether a session was opened in this page. */
export function hasSession() {
  return session !== "";
}

let whenAnswered = () => {};

/** Say what is to happen with the headers of each answer that is no refusal. */
export function onAnswer(act) {
  whenAnswered = act;
}

let unreachable = { detail: "The program behind this page does not answer.", nextStep: "See whether it still runs, and open the page by a new link." };

/** Say in the reader's language what is told when nobody answers: {detail, nextStep}. Until then it is said in English. */
export function tellUnreachable(words) {
  unreachable = words;
}

let underWayCount = 0;

function warn(event) {
  event.preventDefault();
}

/** Have the browser ask before the page is reloaded or closed while `work` is under way: the session would end with it. */
export async function keepOpen(work) {
  underWayCount += 1;
  window.addEventListener("beforeunload", warn);
  try {
    return await work();
  } finally {
    underWayCount -= 1;
    if (underWayCount === 0) window.removeEventListener("beforeunload", warn);
  }
}

async function ask(path, { method = "GET", body, headers = {}, signal } = {}) {
  let response;
  try {
    response = await fetch(path, {
      method,
      signal,
      cache: "no-store",
      credentials: "omit",
      redirect: "error",
      referrerPolicy: "no-referrer",
      headers: { ...(session ? { [SESSION_HEADER]: session } : {}), ...(body === undefined ? {} : { "Content-Type": "application/json" }), ...headers },
      body: body === undefined ? undefined : JSON.stringify(body),
    });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Problem({ code: "UNREACHABLE", ...unreachable, status: 0 });
  }
  if (response.ok) {
    whenAnswered(response.headers);
    return response;
  }
  const problem = await response.json().catch(() => ({}));
  throw new Problem({ code: problem.code ?? "INTERNAL", detail: problem.detail ?? problem.title ?? response.statusText, nextStep: problem.next_step ?? "", status: response.status, command: problem.command });
}

/** Fetch a JSON document. `body` is sent as JSON. Throws a Problem. */
export async function fetchJson(path, options) {
  const response = await ask(path, options);
  return response.status === 204 ? null : response.json();
}

/** Fetch bytes: {bytes: ArrayBuffer, headers}. Throws a Problem. */
export async function fetchBytes(path, options) {
  const response = await ask(path, options);
  return { bytes: await response.arrayBuffer(), headers: response.headers };
}

/** Fetch a stream, for what comes in live: the Response itself. Throws a Problem. */
export function fetchStream(path, options) {
  return ask(path, options);
}
