// Search: says what kind of thing it took the text for, and leads there. Looks at this node alone.

import { h } from "./shared/dom.js";
import { api, entry } from "./api.js";
import { card, go, number, sheet } from "./pieces.js";

const WORDS = "You may look for a block's height, the id of a block or a transaction (64 hexadecimal characters), a contract, or a producer.";

export async function searchPage({ args: [text = ""] }) {
  const wanted = text.trim();
  const found = await lookUp(wanted);
  return sheet("Search", WORDS,
    card(`You looked for “${wanted.length > 70 ? `${wanted.slice(0, 70)}…` : wanted}”`,
      h("p", {}, found.taken),
      found.places.length ? h("ul", { id: "found" }, found.places.map(([place, words]) => h("li", {}, go(place, words)))) : h("p", { id: "found" }, "Nothing was found at this node.")));
}

async function lookUp(wanted) {
  if (/^[\d.,’' ]+$/.test(wanted) && wanted.replace(/\D/g, "").length <= 15) return byHeight(Number(wanted.replace(/\D/g, "")));
  const id = wanted.toLowerCase().replace(/^0x/, "");
  if (/^[0-9a-f]{64}$/.test(id)) return byId(id);
  if (/^[0-9a-f]{65,}$/.test(id)) return { taken: "It is hexadecimal, but too long for an id. Keys are not searched: nobody is to be followed from key to key.", places: [] };
  return byName(wanted);
}

async function byHeight(height) {
  const { head } = await api.status();
  const places = height <= head ? [[`block/${height}`, `Block ${number(height)}`]] : [];
  return { taken: `Taken for a block's height${height > head ? `; the newest final block is ${number(head)}` : ""}.`, places };
}

async function byId(id) {
  const places = [];
  const header = await api.headerOf(id).catch(nothingIfNotFound);
  if (header) places.push([`block/${header.height}`, `Block ${number(header.height)}`]);
  if (header) return { taken: "Taken for an id: it is a block's.", places };
  if (entry.kind !== "member") return { taken: "Taken for an id: it is no block's. Transactions are shown to members only.", places };
  const state = await api.transaction(id);
  if (state.status !== "unknown") places.push([`tx/${id}`, `Transaction, ${state.status}${state.height === null ? "" : ` in block ${number(state.height)}`}`]);
  return { taken: places.length ? "Taken for an id: it is a transaction's." : "Taken for an id: neither a block nor a transaction has it here.", places };
}

function nothingIfNotFound(problem) {
  if (problem.status === 404) return null;
  throw problem;
}

async function byName(wanted) {
  const name = wanted.toLowerCase();
  const { producers } = await api.producers();
  const contracts = entry.kind === "member" ? (await api.contracts()).contracts : [];
  const places = [
    ...contracts.filter((one) => one.name.includes(name)).map((one) => [`contract/${one.name}`, `Contract ${one.name}`]),
    ...producers.filter((one) => one.name.toLowerCase().includes(name)).map((one) => [`producers/${encodeURIComponent(one.name)}`, `Producer ${one.name} of ${one.organisation}`]),
  ];
  return { taken: "Taken for a name, or a part of one, of a contract or a producer.", places: wanted ? places : [] };
}
