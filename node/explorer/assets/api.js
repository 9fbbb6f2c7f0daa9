// What the explorer asks of the node that served it, in one's own session if there is one. The token lives in memory alone.

import { Problem, fetchJson, takeFragment, useSession } from "./shared/fetching.js";
import { decode, encodeList } from "./msgpack.js";

const V1 = "../v1";
const SIGNED = /^in=([0-9a-f]{66})\.([0-9a-f]{64})\.([0-9a-f]{130})$/;
const REMEMBERED_MAX_BYTES = 8 << 20;
const BYTES_A_CHAR = 2;
const remembered = new Map();
let rememberedBytes = 0;

/** How the page got in: `kind` is member, public or none. */
export const entry = { kind: "none", endsMs: 0, reason: null };

/** Pages of this node in the same browser: a session that is opened in one lets those go on whose own has ended. */
const neighbours = new BroadcastChannel("blockrobot-explorer");

/** Use a session's token from here on. It is kept in memory alone. */
function use(token, endsMs) {
  useSession(token, (secret) => ({ Authorization: `Bearer ${secret}` }));
  Object.assign(entry, { kind: "member", endsMs });
}

/** Call `goOn` whenever a neighbour has opened a session and this page's own is over. */
export function followNeighbours(isOver, goOn) {
  neighbours.addEventListener("message", ({ data }) => {
    if (!isOver()) return;
    use(data.token, data.endsMs);
    goOn();
  });
}

/** Take the signed answer out of the address, if there is one, and open a session with it. Returns the status or null. */
export async function enter() {
  const signed = SIGNED.exec(location.hash.slice(1));
  if (location.hash.startsWith("#in=")) takeFragment();
  if (signed) {
    const [, key, challenge, signature] = signed;
    try {
      const answer = await fetchJson(`${V1}/sessions`, { method: "POST", body: { public_key: key, challenge, signature } });
      use(answer.token, answer.expires_at_ms);
      neighbours.postMessage({ token: answer.token, endsMs: answer.expires_at_ms });
    } catch (problem) {
      entry.reason = problem;
    }
  }
  try {
    const status = await api.status();
    if (entry.kind === "none") entry.kind = "public";
    return status;
  } catch (problem) {
    entry.reason ??= problem;
    entry.kind = "none";
    return null;
  }
}

/** Ask for what does not change, and remember it: the answers that were used last, as far as there is room for them. */
async function once(path) {
  const known = remembered.get(path);
  if (known) {
    remembered.delete(path);
    remembered.set(path, known);
    return known.answer;
  }
  const answer = await fetchJson(path);
  remember(path, answer, BYTES_A_CHAR * JSON.stringify(answer).length);
  return answer;
}

function remember(path, answer, bytes) {
  if (bytes > REMEMBERED_MAX_BYTES) return;
  rememberedBytes += bytes - (remembered.get(path)?.bytes ?? 0);
  remembered.set(path, { answer, bytes });
  for (const [oldest, { bytes: size }] of remembered) {
    if (rememberedBytes <= REMEMBERED_MAX_BYTES) return;
    remembered.delete(oldest);
    rememberedBytes -= size;
  }
}

/** What is remembered, and its limit: {count, bytes, most}. */
export const memory = () => ({ count: remembered.size, bytes: rememberedBytes, most: REMEMBERED_MAX_BYTES });

/** A map of the chain as an object with plain names. */
export function objectOf(map) {
  return map instanceof Map ? Object.fromEntries([...map].map(([name, value]) => [String(name?.hex ?? name), value])) : map;
}

export const api = {
  status: (after = 0, waitMs = 0, signal) => fetchJson(`${V1}/explorer/status?after_height=${after}&wait_ms=${waitMs}`, { signal }),
  headers: (from, limit, signal) => fetchJson(`${V1}/explorer/headers?from_height=${from}&limit=${limit}`, { signal }),
  headerOf: (blockId) => fetchJson(`${V1}/explorer/headers/${blockId}`),
  epoch: (number) => once(`${V1}/explorer/epochs/${number}`),
  producers: () => fetchJson(`${V1}/explorer/producers`),
  refusal: (code) => once(`${V1}/explorer/refusals/${encodeURIComponent(code)}`),
  genesis: () => once(`${V1}/genesis`),
  block: (height) => once(`${V1}/blocks/${height}`),
  transaction: (txid) => fetchJson(`${V1}/transactions/${txid}`),
  contracts: () => fetchJson(`${V1}/contracts`),
  contract: (name, version = 0) => fetchJson(`${V1}/contracts/${encodeURIComponent(name)}?version=${version}`),
  /** Ask a view of a contract; the answer is one node's word. */
  async view(contract, view, ...args) {
    const answer = await fetchJson(`${V1}/queries`, { method: "POST", body: { contract, view, args: encodeList(args) } });
    return decode(answer.result);
  },
  /** Read events from a block on; follows the pages, `pagesMax` at most. Returns {events, isAll, upTo}. */
  async events({ from, contract, pagesMax = 20, until }) {
    const events = [];
    let next = `${from}:0`;
    for (let page = 0; page < pagesMax; page += 1) {
      const query = new URLSearchParams({ from: next, limit: "100", ...(contract ? { contract } : {}) });
      const answer = await fetchJson(`${V1}/events/page?${query}`);
      for (const event of answer.events) events.push({ ...event, height: Number(event.place.split(":")[0]), data: objectOf(decode(event.data)) });
      next = answer.next;
      const reached = Number(next.split(":")[0]);
      if (reached > answer.head || (until !== undefined && reached > until)) return { events, isAll: true, upTo: reached };
    }
    return { events, isAll: false, upTo: Number(next.split(":")[0]) };
  },
};

/** A block's transactions as they were signed: contract, entry, arguments, sender. */
export function readTransactions(block) {
  const [, , wires] = decode(block.block);
  return wires.map((wire, index) => {
    const [body] = decode(wire.hex);
    const [, , sender, contract, name, args, validUntilMs] = decode(body.hex);
    return { index, txid: block.txids[index], receipt: block.receipts[index], sender: sender.hex, contract, entry: name, args: decode(args.hex), validUntilMs };
  });
}

export { Problem };
