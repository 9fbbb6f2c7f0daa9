// What the explorer asks, of the node that served it or, in one's own session, of `blockrobot explore`.

import { Problem, fetchJson, openSession } from "./shared/fetching.js";
import { decode, encodeList } from "./msgpack.js";

/** Whether `blockrobot explore` serves this page, at an address that nothing had before. A node's own address has no session:
 * who took it while the node was down may have left a service worker that answers there. */
export const isOwn = !new URL(".", import.meta.url).pathname.endsWith("/explorer/");
const V1 = isOwn ? "./api/v1" : "../v1";
const REMEMBERED_MAX_BYTES = 8 << 20;
const BYTES_A_CHAR = 2;
const remembered = new Map();
let rememberedBytes = 0;

/** How the page got in: `kind` is member, public or none. */
export const entry = { kind: "none", reason: null };

/** Open a session with the command that serves the page, if one does. Returns the status or null. */
export async function enter() {
  try {
    if (isOwn) await openSession();
    const status = await api.status();
    entry.kind = isOwn ? "member" : "public";
    return status;
  } catch (problem) {
    entry.reason = problem;
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
