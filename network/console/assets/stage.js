// What a moment looks like: the verdict, the drawing, the rounds, the tables. The live page and a replay share it.

import { h, replace } from "./shared/dom.js";
import { formatDuration, formatNumber } from "./shared/format.js";
import { createLinks, createNodes } from "./nodes.js";
import { createRounds } from "./rounds.js";
import { createTopology } from "./topology.js";
import { leaderOf, verdict } from "./words.js";

/** Parts of the page, and update(moment, rounds, network): the nodes are those of the moment's time. `beside` stands at the drawing's right. */
export function createStage({ network, onNode, onLink, beside }) {
  const isNarrow = matchMedia("(max-width: 40rem)");
  const topology = createTopology({ network, onNode, onLink, isNarrow });
  const nodes = createNodes({ network, onNode });
  const links = createLinks({ network });
  const rounds = createRounds({ network, isNarrow });
  const seal = h("div", { class: "seal" }, h("div", {}, h("strong", {}), h("p", {})));
  const figures = h("dl", { class: "figures" });
  let facts = network;
  const element = [
    h("section", { class: "headline", "aria-label": "How it is" }, seal, figures),
    h("div", { class: "two" },
      h("section", { class: "card", "aria-labelledby": "topology-title" }, h("h2", { id: "topology-title" }, "The network"), topology.element, legend()),
      beside),
    h("section", { class: "card", "aria-labelledby": "rounds-title" }, h("h2", { id: "rounds-title" }, "The last rounds"), rounds.element,
      key()),
    h("section", { class: "card", "aria-labelledby": "nodes-title" }, h("h2", { id: "nodes-title" }, "Nodes"), nodes.element,
      h("details", {}, h("summary", {}, "Links, one direction a row"), links.element)),
  ];
  return {
    element,
    topology,
    setSelected(name) {
      topology.setSelected(name);
      nodes.setSelected(name);
    },
    update(moment, lastRounds, its) {
      if (its !== facts && JSON.stringify(its) !== JSON.stringify(facts)) {
        facts = its;
        for (const part of [topology, nodes, links, rounds]) part.setNetwork(its);
      }
      showVerdict(seal, figures, moment, facts);
      for (const part of [topology, nodes, links]) part.update(moment);
      rounds.update(lastRounds);
    },
  };
}

function key() {
  const list = (entries) => h("ul", { class: "legend key" }, entries.map((words) => h("li", {}, words)));
  return [list(["● voted", "✕ gave the round up", "◐ both", "· said nothing", "framed: led"]), list(["In the last line:", "✓ certified", "✕ lost", "? no quorum seen"])];
}

function legend() {
  const sample = (kind, words) => h("li", {}, h("span", { class: `sample ${kind}`, "aria-hidden": "true" }), words);
  return h("ul", { class: "legend" }, sample("circle", "producer"), sample("safe", "custodian"), sample("moving", "what arrives"),
    sample("cut", "cut"), sample("slow", "delayed, lossy or narrow"), sample("down", "not connected"), h("li", {}, "number: final height"));
}

function ago(ms) {
  return ms < 1000 ? "just now" : `${formatDuration(Math.floor(ms / 1000) * 1000)} ago`;
}

function showVerdict(seal, figures, moment, network) {
  const said = verdict(moment, network);
  seal.className = `seal ${said.tone}`;
  const [title, text] = seal.firstElementChild.children;
  if (title.textContent !== said.title) title.textContent = said.title;
  if (text.textContent !== said.text) text.textContent = said.text;
  const leader = leaderOf(moment);
  const waiting = Math.max(0, ...moment.nodes.map((node) => node.waiting ?? 0));
  const frames = moment.links.reduce((sum, link) => sum + (link.arrived ?? 0), 0);
  const shown = [["final height", formatNumber(moment.final)], ["last final", ago(moment.at_ms - moment.final_since_ms)],
    ["leads", leader ? leader.leader ?? "nobody" : "-"], ["round", leader ? formatNumber(leader.round) : "-"], ["epoch", leader?.epoch ?? "-"],
    ["transactions waiting", formatNumber(waiting)], ["frames/s", formatNumber(Math.round(frames))]];
  if (figures.children.length !== shown.length) replace(figures, shown.map(([name]) => h("div", {}, h("dt", {}, name), h("dd", {}))));
  shown.forEach(([, value], index) => { figures.children[index].lastElementChild.textContent = value; });
}
