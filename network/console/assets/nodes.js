// The table of nodes: everything that the drawing says, and more, for eyes, ears and keyboards.

import { h, replace } from "./shared/dom.js";
import { LINK_WORDS, allLinks, clockWords, disksWords, leaderOf, stateReason, stateWords, toneOf } from "./words.js";

const COLUMNS = [["node"], ["state"], ["final height", true], ["blocks behind", true], ["newest height", true], ["round", true], ["leads"], ["peers", true],
  ["transactions waiting", true], ["clock"], ["disks"], ["faults"], ["organisation"]];

/** {element, update(moment), setSelected(name)}; with onNode, names are buttons. */
export function createNodes({ network, onNode }) {
  const body = h("tbody", {});
  let facts = new Map(network.nodes.map((node) => [node.name, node]));
  let rows = new Map();
  let selected = null;
  const element = h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": "All nodes" },
    h("table", { class: "list nodes" }, h("caption", { class: "visually-hidden" }, "All nodes"),
      h("thead", {}, h("tr", {},
        COLUMNS.map(([name, isNumber]) => h("th", { scope: "col", class: isNumber ? "number" : undefined }, name)))), body));
  return {
    element,
    setNetwork(changed) {
      facts = new Map(changed.nodes.map((node) => [node.name, node]));
      rows = new Map();
      replace(body);
    },
    setSelected(name) {
      selected = name;
      for (const [own, row] of rows) row.classList.toggle("selected", own === name);
    },
    update(moment) {
      const leads = leaderOf(moment)?.leader;
      for (const node of moment.nodes) {
        let row = rows.get(node.name);
        if (!row) {
          const name = onNode ? h("button", { type: "button", class: "plain", onclick: () => onNode(node.name) }, node.name) : node.name;
          row = h("tr", { class: node.name === selected ? "selected" : undefined }, h("th", { scope: "row" }, name), COLUMNS.slice(1).map(([, isNumber]) => h("td", { class: isNumber ? "number" : undefined })));
          rows.set(node.name, row);
          body.append(row);
        }
        fill(row, node, facts.get(node.name), leads === node.name);
      }
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
    else if (cell.textContent !== text) cell.textContent = text;
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

/** The table of links, one direction a row: {element, update(moment)}. */
export function createLinks({ network }) {
  const body = h("tbody", {});
  let names = network.nodes.map((node) => node.name);
  const element = h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": "All links" },
    h("table", { class: "list" }, h("caption", { class: "visually-hidden" }, "All links, one direction a row"),
      h("thead", {}, h("tr", {}, ["from", "to", "state"].map((name) => h("th", { scope: "col" }, name)),
        ["sent /s", "arrive /s", "kB/s"].map((name) => h("th", { scope: "col", class: "number" }, name)), h("th", { scope: "col" }, "what arrives, frames /s"))), body));
  return {
    element,
    setNetwork(changed) {
      names = changed.nodes.map((node) => node.name);
    },
    update(moment) {
      replace(body, [...allLinks(moment, names).values()].map((link) => h("tr", {},
        h("td", {}, link.from), h("td", {}, link.to), h("td", {}, LINK_WORDS[link.state], link.words && link.words !== "cut" ? ` (${link.words})` : ""),
        h("td", { class: "number" }, link.sent ?? "0"), h("td", { class: "number" }, link.arrived ?? "0"),
        h("td", { class: "number" }, ((link.bytes ?? 0) / 1000).toFixed(1)),
        h("td", {}, Object.entries(link.kinds ?? {}).map(([kind, count]) => `${kind.replaceAll("_", " ")} ${count}`).join(", ") || "-"))));
    },
  };
}
