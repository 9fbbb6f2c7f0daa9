// The table of nodes: everything that the drawing says, and more, for eyes, ears and keyboards.

import { h, replace } from "./shared/dom.js";
import { arrange, createKept, write } from "./keeping.js";
import { LINK_WORDS, allLinks, clockWords, disksWords, leaderOf, stateReason, stateWords, toneOf } from "./words.js";

const COLUMNS = [["node"], ["state"], ["final height", true], ["blocks behind", true], ["newest height", true], ["round", true], ["leads"], ["peers", true],
  ["transactions waiting", true], ["clock"], ["disks"], ["faults"], ["organisation"]];

/** {element, update(moment), setSelected(name), setNetwork(changed)}; with onNode, names are buttons. A node keeps its row. */
export function createNodes({ network, onNode }) {
  const body = h("tbody", {});
  const rows = createKept();
  let facts = new Map(network.nodes.map((node) => [node.name, node]));
  let selected = null;
  const element = h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": "All nodes" },
    h("table", { class: "list nodes" }, h("caption", { class: "visually-hidden" }, "All nodes"),
      h("thead", {}, h("tr", {},
        COLUMNS.map(([name, isNumber]) => h("th", { scope: "col", class: isNumber ? "number" : undefined }, name)))), body));
  const make = (name) => h("tr", { class: name === selected ? "selected" : undefined },
    h("th", { scope: "row" }, onNode ? h("button", { type: "button", class: "plain", onclick: () => onNode(name) }, name) : name),
    COLUMNS.slice(1).map(([, isNumber]) => h("td", { class: isNumber ? "number" : undefined })));
  return {
    element,
    setNetwork(changed) { facts = new Map(changed.nodes.map((node) => [node.name, node])); },
    setSelected(name) {
      selected = name;
      for (const [own, row] of rows.entries()) row.classList.toggle("selected", own === name);
    },
    update(moment) {
      const leads = leaderOf(moment)?.leader;
      rows.keep(moment.nodes.map((node) => node.name));
      arrange(body, moment.nodes.map((node) => {
        const row = rows.get(node.name, () => make(node.name));
        fill(row, node, facts.get(node.name), leads === node.name);
        return row;
      }));
    },
  };
}

function fill(row, node, facts, isLeader) {
  const figure = (value) => (value === undefined ? "-" : String(value));
  const roles = [facts?.producer && "producer", facts?.custodian && "custodian"].filter(Boolean).join(", ") || "follows";
  showState(row.children[1], node);
  const cells = [figure(node.final), figure(node.lag), figure(node.height), figure(node.round), node.leader === undefined ? "-" : isLeader ? "yes" : "no",
    figure(node.peers), figure(node.waiting), clockWords(node), disksWords(node), null, `${facts?.organisation ?? "-"} (${roles})`];
  cells.forEach((text, index) => {
    const cell = row.children[index + 2];
    if (text === null) showFaults(cell, node.faults ?? []);
    else write(cell, text);
  });
}

function showFaults(cell, faults) {
  const said = faults.map((fault) => fault.replace(/^-> /, "to "));
  if (cell.dataset.said === said.join("; ")) return;
  cell.dataset.said = said.join("; ");
  replace(cell, said.length ? said.map((fault) => h("span", { class: "fault" }, fault)) : "-");
}

function showState(cell, node) {
  const words = stateWords(node);
  const reason = stateReason(node);
  const badge = cell.firstElementChild;
  if (badge && cell.textContent === words + reason && badge.classList.contains(toneOf(node))) return;
  replace(cell, h("span", { class: `badge ${toneOf(node)}` }, words), reason && h("div", { class: "reason" }, reason));
}

/** The table of links, one direction a row, which is kept: {element, update(moment), setNetwork(changed)}. */
export function createLinks({ network }) {
  const body = h("tbody", {});
  const rows = createKept();
  let names = network.nodes.map((node) => node.name);
  const element = h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": "All links" },
    h("table", { class: "list links" }, h("caption", { class: "visually-hidden" }, "All links, one direction a row"),
      h("thead", {}, h("tr", {}, ["from", "to", "state"].map((name) => h("th", { scope: "col" }, name)),
        ["sent /s", "arrive /s", "kB/s"].map((name) => h("th", { scope: "col", class: "number" }, name)), h("th", { scope: "col" }, "what arrives, frames /s"))), body));
  const make = () => h("tr", {}, LINK_CELLS.map((kind) => h("td", { class: kind || undefined })));
  return {
    element,
    setNetwork(changed) {
      names = changed.nodes.map((node) => node.name);
    },
    update(moment) {
      const links = [...allLinks(moment, names)];
      rows.keep(links.map(([key]) => key));
      arrange(body, links.map(([key, link]) => {
        const row = rows.get(key, make);
        linkWords(link).forEach((text, index) => write(row.children[index], text));
        return row;
      }));
    },
  };
}

const LINK_CELLS = ["", "", "", "number", "number", "number", ""];

function linkWords(link) {
  const cause = link.words && link.words !== "cut" ? ` (${link.words})` : "";
  const kinds = Object.entries(link.kinds ?? {}).map(([kind, count]) => `${kind.replaceAll("_", " ")} ${count}`);
  return [link.from, link.to, `${LINK_WORDS[link.state]}${cause}`, link.sent ?? "0", link.arrived ?? "0", ((link.bytes ?? 0) / 1000).toFixed(1), kinds.join(", ") || "-"];
}
