// The strip of rounds: who led, who voted, who gave up. A table, newest round on the right.

import { h, replace } from "./shared/dom.js";

const WIDE_COUNT = 24;
const NARROW_COUNT = 6;

/** {element, update(rounds)}: rounds oldest first. */
export function createRounds({ network, isNarrow }) {
  const place = h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": "Rounds, oldest first" });
  let shown = [];
  let names = network.nodes.filter((node) => node.producer).map((node) => node.name);
  const draw = () => replace(place, shown.length ? table(shown.slice(-(isNarrow.matches ? NARROW_COUNT : WIDE_COUNT)), names)
    : h("p", { class: "quiet" }, "No round was seen yet. An idle network makes a block only now and then."));
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

function table(rounds, names) {
  const base = rounds.length && Math.max(...rounds.map((round) => round.round)) > 999 ? 1000 : 0;
  return h("table", { class: "rounds" },
    h("caption", { class: "visually-hidden" }, "The last rounds: who led, who voted, who gave up"),
    h("thead", {}, h("tr", {}, h("th", { scope: "col" }, "round"),
      rounds.map((round) => h("th", { scope: "col", title: `Round ${round.round} of epoch ${round.epoch}` },
        base ? `…${String(round.round).slice(-3)}` : String(round.round))))),
    h("tbody", {},
      names.map((name) => h("tr", {}, h("th", { scope: "row" }, name), rounds.map((round) => cell(round, name)))),
      h("tr", { class: "outcome" }, h("th", { scope: "row" }, "came of it"),
        rounds.map((round) => h("td", { class: round.outcome, title: OUTCOMES[round.outcome][1] },
          h("span", { "aria-hidden": "true" }, OUTCOMES[round.outcome][0]), h("span", { class: "visually-hidden" }, OUTCOMES[round.outcome][1]))))));
}

function cell(round, name) {
  const voted = round.voted.includes(name);
  const gaveUp = round.gave_up.includes(name);
  const leads = round.leader === name;
  const words = [leads && "led", voted && "voted", gaveUp && "gave up", !voted && !gaveUp && "said nothing"].filter(Boolean).join(", ");
  const sign = gaveUp ? (voted ? "◐" : "✕") : voted ? "●" : "·";
  return h("td", { class: `${gaveUp ? "gave-up" : voted ? "voted" : "silent"}${leads ? " led" : ""}`, title: `${name}, round ${round.round}: ${words}` },
    h("span", { "aria-hidden": "true" }, sign), h("span", { class: "visually-hidden" }, words));
}
