// The strip of rounds: who led, who voted, who gave up. A table, newest round on the right. Must never move the reader's place.

import { h } from "./shared/dom.js";
import { arrange, createKept, mark, write } from "./keeping.js";

const WIDE_COUNT = 24;
const NARROW_COUNT = 6;

/** {element, update(rounds), setNetwork(changed)}: rounds oldest first. A producer keeps its row, a round its cells. */
export function createRounds({ network, isNarrow }) {
  const head = h("tr", {});
  const body = h("tbody", {});
  const table = h("table", { class: "rounds" }, h("caption", { class: "visually-hidden" }, "The last rounds: who led, who voted, who gave up"), h("thead", {}, head), body);
  const none = h("p", { class: "quiet" }, "No round was seen yet. An idle network makes a block only now and then.");
  const place = h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": "Rounds, oldest first" });
  const lines = createKept();
  let shown = [];
  let names = network.nodes.filter((node) => node.producer).map((node) => node.name);
  const draw = () => {
    const rounds = shown.slice(-(isNarrow.matches ? NARROW_COUNT : WIDE_COUNT));
    arrange(place, [rounds.length ? table : none]);
    if (rounds.length) drawLines(lines, head, body, rounds, names);
  };
  isNarrow.addEventListener("change", draw);
  return {
    element: place,
    setNetwork(changed) {
      names = changed.nodes.filter((node) => node.producer).map((node) => node.name);
    },
    update(rounds) {
      shown = rounds;
      draw();
    },
  };
}

const OUTCOMES = { won: ["✓", "certified"], lost: ["✕", "lost"], open: ["?", "no quorum seen"] };
const keyOf = (round) => `${round.epoch} ${round.round}`;

function drawLines(lines, head, body, rounds, names) {
  const keys = rounds.map(keyOf);
  const base = Math.max(...rounds.map((round) => round.round)) > 999;
  const line = (key, makeRow, makeFirst, show) => {
    const own = lines.get(key, () => ({ row: makeRow(), first: makeFirst(), cells: createKept() }));
    own.cells.keep(keys);
    arrange(own.row, [own.first, ...rounds.map((round, index) => show(own.cells, round, keys[index]))]);
    return own.row;
  };
  lines.keep(["head", "outcome", ...names.map((name) => `of ${name}`)]);
  line("head", () => head, () => h("th", { scope: "col" }, "round"), (cells, round, key) => {
    const cell = cells.get(key, () => h("th", { scope: "col", title: `Round ${round.round} of epoch ${round.epoch}` }));
    write(cell, base ? `…${String(round.round).slice(-3)}` : String(round.round));
    return cell;
  });
  const told = (kind, name, tell) => line(kind, () => h("tr", { class: kind === "outcome" ? kind : undefined }), () => h("th", { scope: "row" }, name), (cells, round, key) => {
    const cell = cells.get(key, () => h("td", {}, h("span", { "aria-hidden": "true" }), h("span", { class: "visually-hidden" })));
    const { look, title, sign, words } = tell(round);
    mark(cell, "class", look);
    mark(cell, "title", title);
    write(cell.firstElementChild, sign);
    write(cell.lastElementChild, words);
    return cell;
  });
  arrange(body, [...names.map((name) => told(`of ${name}`, name, (round) => tellOf(round, name))), told("outcome", "came of it", tellOutcome)]);
}

function tellOutcome({ outcome }) {
  const [sign, words] = OUTCOMES[outcome];
  return { look: outcome, title: words, sign, words };
}

function tellOf(round, name) {
  const voted = round.voted.includes(name);
  const gaveUp = round.gave_up.includes(name);
  const leads = round.leader === name;
  const words = [leads && "led", voted && "voted", gaveUp && "gave up", !voted && !gaveUp && "said nothing"].filter(Boolean).join(", ");
  const sign = gaveUp ? (voted ? "◐" : "✕") : voted ? "●" : "·";
  return { look: `${gaveUp ? "gave-up" : voted ? "voted" : "silent"}${leads ? " led" : ""}`, title: `${name}, round ${round.round}: ${words}`, sign, words };
}
