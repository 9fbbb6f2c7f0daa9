// One transaction: the call as it was signed, what became of it, what it told. Arguments are shown, never interpreted.

import { h } from "./shared/dom.js";
import { api, readTransactions } from "./api.js";
import { badge, card, facts, fullHex, go, moment, number, problemView, sheet, valueView } from "./pieces.js";

const WORDS = "A transaction is one signed call of a contract's entry. Every node runs it in the same place of the chain and comes to the same receipt. A refused call changes nothing but this receipt.";
const NOT_FINAL = {
  pending: "It waits in this node's pool, or stands in a block that is not final yet.",
  expired: "It was not put into a block in time. It never will be: its sender may sign it again.",
  unknown: "This node has never seen it. Another node may; or the id is not whole.",
};

export async function transactionPage({ args: [txid = ""] }) {
  if (!/^[0-9a-f]{64}$/.test(txid)) return sheet("Transaction", WORDS, problemView({ detail: "This is no transaction's id: it has 64 hexadecimal digits, in small letters.", nextStep: "See whether the address was copied whole." }));
  const state = await api.transaction(txid);
  if (state.status !== "finalized") {
    return sheet("Transaction", WORDS, card(null, facts([["id", fullHex(txid)], ["state", badge(state.status), NOT_FINAL[state.status]]])));
  }
  const block = await api.block(state.height);
  const one = readTransactions(block)[state.index];
  const contract = await api.contract(one.contract).catch(() => null);
  const entry = contract?.abi.find((known) => known.name === one.entry) ?? null;
  const read = await api.events({ from: state.height, until: state.height });
  const events = read.events.filter((event) => event.txid === txid && event.height === state.height);
  return sheet("Transaction", WORDS,
    card("What became of it", await outcome(state, one)),
    card("The call", facts([
      ["id", fullHex(txid), "A hash of the signed bytes."],
      ["block", go(`block/${state.height}`, `${number(state.height)}, place ${state.index}`)],
      ["contract", go(`contract/${one.contract}`, one.contract)],
      ["entry", h("span", { class: "mono" }, one.entry), entry ? null : "The version in force has no such entry."],
      ["signed by", fullHex(one.sender), "A key. Whose it is, the chain says only of nodes, officials and robots; of persons it knows keys alone."],
      ["valid until", moment(one.validUntilMs), "After that no block may hold it."],
    ]), h("h3", {}, "Arguments"), argumentsView(one.args, entry)),
    card("What it told", events.length ? events.map((event) => h("div", { class: "stack event" }, h("h3", {}, h("span", { class: "mono" }, `${event.contract}.${event.name}`), " ", h("span", { class: "quiet" }, event.place)), valueView(event.data)))
      : h("p", { class: "quiet" }, "It emitted no event.")));
}

function argumentsView(args, entry) {
  if (!args.length) return h("p", { class: "quiet" }, "None.");
  return h("dl", { class: "facts value" }, args.map((value, index) => {
    const known = entry?.parameters[index];
    return [h("dt", {}, known ? [known.name, " ", h("span", { class: "quiet mono" }, known.type)] : `no. ${index}`), h("dd", {}, valueView(value))];
  }));
}

async function outcome(state, one) {
  const { receipt } = state;
  const gas = ["gas", number(receipt.gas_used), "The work that it took, in the machine's own measure."];
  if (receipt.ok) return facts([["outcome", badge("done", "good"), "The contract did what it was asked to do."], gas]);
  const meaning = await api.refusal(receipt.code).catch(() => null);
  return facts([
    ["outcome", badge("refused", "bad"), "The state is as if it had never been called."],
    ["code", h("span", { class: "mono" }, receipt.code), meaning?.meaning],
    receipt.message && ["in the contract's words", receipt.message],
    meaning?.next_step && ["what helps", meaning.next_step],
    receipt.line !== null && ["where", go(`contract/${one.contract}/0/${receipt.line}`, `line ${receipt.line} of a contract that ran`), "In the version that was in force then."],
    gas,
  ]);
}
