// The live page: blocks as they become final, the round the node is in, how long finality takes, rounds that were lost.

import { h, replace } from "./shared/dom.js";
import { lineChart } from "./shared/chart.js";
import { formatClock, plural, zoneOffset } from "./shared/format.js";
import { api } from "./api.js";
import { feed } from "./feed.js";
import { badge, card, chartWidth, go, number, row, seatMarks, seatName, sheet } from "./pieces.js";

const SHOWN_COUNT = 20;
const CHARTED_COUNT = 100;
const LISTED_COUNT = 10;
const KINDS = ["number", "", "", "number", "number", "", ""];

export async function livePage({ signal }) {
  const figures = h("div", { class: "grid" });
  const lag = h("div", {});
  const lost = h("div", {});
  const body = h("tbody", {});
  const rows = new Map();
  const seconds = { isPaused: false };
  const pauseButton = h("button", { type: "button", "aria-pressed": "false", onclick: () => {
    seconds.isPaused = !seconds.isPaused;
    pauseButton.setAttribute("aria-pressed", String(seconds.isPaused));
    pauseButton.textContent = seconds.isPaused ? "Go on" : "Hold still";
    if (!seconds.isPaused) update();
  } }, "Hold still");

  async function update() {
    if (seconds.isPaused || signal.aborted) return;
    const shown = feed.headers.slice(-SHOWN_COUNT);
    const epochs = await readEpochs([...shown.map((header) => header.epoch), feed.status.rounds?.epoch ?? feed.status.epoch]);
    if (signal.aborted || seconds.isPaused) return;
    replace(figures, figureCards(epochs));
    replace(lag, lagChart());
    replace(lost, lostRounds(epochs));
    updateRows(body, rows, shown, epochs);
  }
  feed.follow(update, signal);
  addEventListener("resize", update, { signal });
  await update();
  return sheet("Live",
    "A block is final once a quorum of producers has certified it and its child in the next round: from then on nothing undoes it. Each round has one leader, who proposes a block; if it comes too late, the producers give the round up together and the next one leads. A quiet network makes an empty block only now and then.",
    figures,
    card("How long finality takes", h("p", { class: "quiet" }, "From the time in a block's header to the moment this node learned that it is final, for the newest blocks with transactions. The two times are by clocks of two nodes, which may differ a little."), lag),
    card("Newest blocks", h("div", { class: "row" }, h("p", { class: "quiet" }, "The marks show whose votes are in the block's certificate. It holds exactly a quorum, so somebody honest is often left out."), h("span", { class: "push" }, pauseButton)),
      h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Newest blocks" },
        h("table", { class: "list", id: "blocks" }, h("caption", { class: "visually-hidden" }, "Newest blocks"),
          h("thead", {}, h("tr", {}, ["height", "producer", "votes", "transactions", "gas", "time", ""].map((head, index) => h("th", { scope: "col", class: KINDS[index] }, head || h("span", { class: "visually-hidden" }, "notes"))))), body))),
    card("Rounds that the network lost", lost));
}

async function readEpochs(numbers) {
  const found = new Map();
  await Promise.all([...new Set(numbers)].map(async (number) => found.set(number, await api.epoch(number).catch(() => null))));
  return found;
}

function figure(name, value, words) {
  return h("div", { class: "card" }, h("div", { class: "quiet" }, name), h("div", { class: "figure" }, value), h("div", { class: "quiet" }, words));
}

function figureCards(epochs) {
  const { status } = feed;
  const { rounds, counts } = status;
  const newest = feed.headers.at(-1);
  const timed = feed.headers.findLast(isTimed);
  return [
    figure("Newest final block", go(`block/${status.head}`, number(status.head)), newest ? `made at ${formatClock(newest.timestamp_ms)} ${zoneOffset(newest.timestamp_ms)}` : ""),
    rounds && figure("Round", number(rounds.round), `of epoch ${rounds.epoch}; ${seatName(epochs.get(rounds.epoch), rounds.leader)} leads it. Not final: this is where the node stands.`),
    finalityFigure(timed),
    rounds && figure("Given up by this node", plural(rounds.timed_out_count, "round", "rounds"), "since its start, for their leader was late; lost is a round only if a quorum gave it up"),
    figure("Network", status.network, `${plural(counts.organisations, "organisation", "organisations")}, ${plural(counts.nodes, "node", "nodes")}, ${plural(counts.producers, "producer", "producers")}, ${plural(counts.contracts, "contract", "contracts")}`),
  ];
}

/** An empty block may wait for the next work before it is final: only those with transactions say how long it takes. */
function isTimed(header) {
  return header.finality_lag_ms !== null && header.transaction_count > 0;
}

/** A block that was final before its producer's clock says it was made tells of two clocks, and not how long it took. */
function finalityFigure(timed) {
  if (!timed) return figure("Finality took", "–", "no block with transactions yet");
  const of = `block ${number(timed.height)}, the newest with transactions`;
  if (timed.finality_lag_ms < 0) return figure("Finality took", "clocks differ", `this node's clock is ${number(-timed.finality_lag_ms)} ms or more behind that of the producer of ${of}`);
  return figure("Finality took", `${number(timed.finality_lag_ms)} ms`, `for ${of}`);
}

function lagChart() {
  const timed = feed.headers.filter(isTimed).slice(-CHARTED_COUNT);
  const points = timed.filter((header) => header.finality_lag_ms >= 0).map((header) => [header.height, header.finality_lag_ms]);
  const leftOut = timed.length - points.length;
  const note = leftOut > 0 && h("p", { class: "quiet" }, `${plural(leftOut, "block is", "blocks are")} left out: the clocks of this node and of the producer differ.`);
  if (points.length < 2) return [h("p", {}, "This node has seen too few blocks with transactions become final since its start."), note];
  return [chartOf(points), note];
}

function chartOf(points) {
  return lineChart({ series: [{ name: "finality", points }], width: chartWidth(), height: 180, label: "Time to finality by height", unit: "ms", formatX: (height) => `block ${Math.round(height)}` });
}

/** The rounds that the chain says were lost; a node may have given up more, alone or before these blocks. */
function lostRounds(epochs) {
  const lost = feed.headers.filter((header) => header.missed_count > 0).slice(-LISTED_COUNT).reverse();
  const total = feed.headers.reduce((sum, header) => sum + header.missed_count, 0);
  const where = feed.headers.length ? `blocks ${number(feed.headers[0].height)} to ${number(feed.last)}` : "the blocks that are here";
  const { rounds } = feed.status;
  const own = rounds?.timed_out_count > 0 && h("p", { class: "quiet" },
    `This node itself gave up ${plural(rounds.timed_out_count, "round", "rounds")} since its start. Not each of them is lost: a round that a quorum still certified brought its block, and others may lie before these blocks or after them.`);
  if (!lost.length) return [h("p", {}, `By ${where} no round was lost: none of them carries the word of a quorum that it gave a round up.`), own];
  return [
    h("p", {}, `By ${where} ${plural(total, "round was", "rounds were")} lost: a quorum gave up.${lost.length === LISTED_COUNT ? ` The newest ${LISTED_COUNT} places:` : ""}`),
    h("ul", {}, lost.map((header) => {
      const epoch = epochs.get(header.epoch);
      const leaders = [...new Set(header.missed)].map((index) => seatName(epoch, index)).join(", ");
      return h("li", {}, go(`block/${header.height}`, `Before block ${number(header.height)}`), `: ${plural(header.missed_count, "round", "rounds")}, which ${leaders} should have led.`);
    })),
    own,
  ];
}

/** Add what is new on top and drop what is old below: rows that stay are left alone, also the focus in them. */
function updateRows(body, rows, shown, epochs) {
  for (const [height, known] of rows) {
    if (height < shown[0]?.height || height > (shown.at(-1)?.height ?? -1)) {
      known.remove();
      rows.delete(height);
    }
  }
  for (const header of shown) {
    if (rows.has(header.height)) continue;
    const made = blockRow(header, epochs.get(header.epoch));
    rows.set(header.height, made);
    body.prepend(made);
  }
}

function blockRow(header, epoch) {
  const notes = [
    header.missed_count > 0 && badge(plural(header.missed_count, "round lost", "rounds lost"), "warn"),
    header.is_boundary && badge("new epoch follows", "accent"),
    header.is_closing && badge("closes an epoch"),
  ];
  return row([
    go(`block/${header.height}`, number(header.height)),
    header.height === 0 ? "genesis" : seatName(epoch, header.producer),
    header.certificate ? seatMarks(epoch, header.certificate.voters) : "",
    header.transaction_count === null ? "pruned" : number(header.transaction_count),
    number(header.gas_used),
    formatClock(header.timestamp_ms),
    notes,
  ], KINDS);
}
