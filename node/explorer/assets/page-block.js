// One block: what its header says and means, who certified it, what it holds.

import { h } from "./shared/dom.js";
import { plural } from "./shared/format.js";
import { api, entry, readTransactions } from "./api.js";
import { feed } from "./feed.js";
import { badge, card, certificateDrawing, facts, fullHex, go, hex, moment, number, problemView, seatName, sheet, table } from "./pieces.js";

export async function blockPage({ args: [which] }) {
  const header = await findHeader(which ?? "");
  const epoch = await api.epoch(header.epoch).catch(() => null);
  const { height } = header;
  const head = Math.max(feed.status?.head ?? 0, height);
  return sheet(`Block ${number(height)}`,
    "A block is a header and its transactions. The header names the block before it, who led the round, and the roots under which every transaction, receipt and value of the state can be proved.",
    h("nav", { class: "row", "aria-label": "Neighbours" }, height > 0 && h("a", { class: "button", href: `#/block/${height - 1}` }, "← the one before"), height < head && h("a", { class: "button", href: `#/block/${height + 1}` }, "the next one →")),
    certificateCard(header, epoch),
    header.timeout && timeoutCard(header, epoch),
    card("Header", headerFacts(header, epoch)),
    await transactionsCard(header));
}

async function findHeader(which) {
  if (/^[0-9a-f]{64}$/.test(which)) return api.headerOf(which);
  const height = /^\d{1,15}$/.test(which) ? Number(which) : -1;
  const known = feed.at(height);
  if (known?.certificate && known.height === height) return known;
  const { headers } = height < 0 ? { headers: [] } : await api.headers(height, 1);
  if (headers.length) return headers[0];
  throw Object.assign(new Error(), { status: 404, detail: `There is no final block ${which} at this node.`, nextStep: `The newest one is ${feed.status?.head ?? "not known"}.` });
}

function certificateCard(header, epoch) {
  if (header.height === 0) return card("Certificate", h("p", {}, "The genesis block needs none: everybody has it in the genesis file."));
  const { certificate } = header;
  if (!certificate || !epoch) return card("Certificate", h("p", {}, "This node does not tell who certified the block."));
  return card("Who certified it",
    h("p", {}, `${certificate.voters.length} of ${epoch.seats.length} producers signed this very block in round ${certificate.round}: a quorum (${epoch.quorum}). The next block carries their signatures. Any two quorums share an honest producer, and each votes once a round: so no other block of this round has one. Once its child of the next round was certified as well, the block was final.`),
    certificateDrawing(epoch, certificate.voters, { leader: header.producer, label: `Certificate of block ${header.height}` }));
}

function timeoutCard(header, epoch) {
  const { timeout, missed, missed_count: count } = header;
  const leaders = [...new Set(missed)].map((index) => seatName(epoch, index)).join(", ");
  return card("A round was given up before it",
    h("p", {}, `${plural(count, "round", "rounds")} before this block brought none: ${leaders} should have led. The producers below signed that they waited long enough in round ${timeout.round}; with these signatures the next leader could go on.`),
    epoch && certificateDrawing(epoch, timeout.voters, { leader: missed.at(-1), led: "awaited", label: `Timeout certificate of round ${timeout.round}`, tone: "gave-up" }));
}

function headerFacts(header, epoch) {
  const { height } = header;
  return facts([
    ["height", number(height), "How many blocks came before it."],
    ["id", fullHex(header.block_id), "The SHA-256 of the header's bytes: change one bit and it is another block."],
    ["parent", height > 0 ? go(`block/${height - 1}`, hex(header.parent_id)) : hex(header.parent_id), "The id of the block before."],
    ["round", `${number(header.round)} of epoch ${header.epoch}`, header.missed_count > 0 ? `${plural(header.missed_count, "round", "rounds")} before it were given up.` : "Right after its parent's round."],
    ["producer", height === 0 ? "none" : seatName(epoch, header.producer), "Who led the round and made the block."],
    ["time", moment(header.timestamp_ms), "By its producer's clock; never before its parent's."],
    header.finality_lag_ms !== null && ["final after", header.finality_lag_ms < 0 ? "clocks differ" : `${number(header.finality_lag_ms)} ms`, header.finality_lag_ms < 0 ? `By this node's clock it was final ${number(-header.finality_lag_ms)} ms before its producer's clock says it was made.` : "When this node learned that it is final."],
    ["transactions root", hex(header.transactions_root), "Merkle root over the ids of its transactions."],
    ["receipts root", hex(header.receipts_root), "Merkle root over what became of them."],
    ["state root", hex(header.state_root), "Root of the whole state after this block: any value, or its absence, can be proved against it."],
    ["gas", number(header.gas_used), "How much work its calls took."],
    ["form", `version ${header.version}`, header.is_boundary ? "It ends its epoch: producers or settings change after it." : header.is_closing ? "It is empty and helps the end of its epoch to become final." : null],
  ]);
}

async function transactionsCard(header) {
  const count = header.transaction_count;
  if (count === null && entry.kind !== "member") return card("Transactions", h("p", {}, "This node has dropped the block's body, since it is old; its header and what it wrote stay."));
  if (count === 0) return card("Transactions", h("p", {}, "None: it is an empty block, made so that the chain shows that it lives, or so that blocks before it become final."));
  if (entry.kind !== "member") return card("Transactions", h("p", {}, `${plural(count, "transaction", "transactions")}. What they say is for members of the network.`));
  try {
    const transactions = readTransactions(await api.block(header.height));
    const rows = transactions.map((one) => [number(one.index), go(`tx/${one.txid}`, hex(one.txid)), h("span", { class: "mono" }, `${one.contract}.${one.entry}`), one.receipt.ok ? badge("done", "good") : badge(one.receipt.code, "bad"), number(one.receipt.gas_used), hex(one.sender)]);
    return card("Transactions", table(plural(count, "transaction", "transactions"), [["no.", "number"], "id", "call", "outcome", ["gas", "number"], "signed by"], rows));
  } catch (problem) {
    return card("Transactions", problemView(problem));
  }
}
