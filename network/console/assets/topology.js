// The network drawn: organisations as regions, nodes, both directions of each link, what flows. Elements are made once
// and only changed afterwards, so that what moves keeps moving; a node's own stays as long as the node, and the focus with
// it. Never the only way: a table stands beside it.

import { replace, s } from "./shared/dom.js";
import { arrange, createKept } from "./keeping.js";
import { allLinks, leaderOf, linkSentence, stateReason, stateWords, toneOf } from "./words.js";

const WIDE = { width: 720, height: 440, rx: 250, ry: 185, radius: 29, region: 96 };
const NARROW = { width: 380, height: 400, rx: 128, ry: 165, radius: 26, region: 78 };
const PAIRS_DRAWN_MAX_COUNT = 6;  // beyond that both directions of a link share a line, and nodes are smaller
const MANY_SHRINK = 0.8;
const GROUPS_MAX_COUNT = 4;

/** {element, update(moment), setGroups(Map|null), setSelected(name)}; onNode(name), onLink(from, to). */
export function createTopology({ network, onNode, onLink, isNarrow }) {
  const svg = s("svg", { class: "topology", role: "group", "aria-label": "The network: nodes and links. The table of nodes says the same." });
  const state = { network, shape: null, nodes: createKept(), links: new Map(), groups: null, selected: null, moment: null };
  svg.append(s("g", {}), s("g", {}), s("g", {})); // regions, links and, on top, nodes
  const draw = (narrow) => {
    state.shape = shapeFor(state.network.nodes.length, narrow ? NARROW : WIDE);
    svg.classList.toggle("many", isMany(state.network));
    layOut(svg, state, onNode, onLink);
    if (state.moment) show(state);
  };
  draw(isNarrow.matches);
  isNarrow.addEventListener("change", (event) => draw(event.matches));
  return {
    element: svg,
    update(moment) {
      state.moment = moment;
      show(state);
    },
    setNetwork(changed) {
      state.network = changed;
      draw(isNarrow.matches);
    },
    setGroups(groups) {
      state.groups = groups;
      if (state.moment) show(state);
    },
    setSelected(name) {
      state.selected = name;
      if (state.moment) show(state);
    },
  };
}

const isMany = (network) => network.nodes.length > PAIRS_DRAWN_MAX_COUNT;

function shapeFor(count, shape) {
  return count > PAIRS_DRAWN_MAX_COUNT ? { ...shape, radius: Math.round(shape.radius * MANY_SHRINK), region: Math.round(shape.region * MANY_SHRINK) } : shape;
}

function places(network, shape) {
  const organisations = [...new Set(network.nodes.map((node) => node.organisation))];
  const gap = organisations.length > 1 ? 0.35 : 0;
  const total = network.nodes.length + gap * organisations.length;
  const found = new Map();
  const regions = [];
  const first = network.nodes.filter((node) => node.organisation === organisations[0]).length;
  let unit = -(first - 1) / 2;
  for (const organisation of organisations) {
    const members = network.nodes.filter((node) => node.organisation === organisation);
    const from = unit;
    for (const node of members) {
      found.set(node.name, point(shape, unit / total));
      unit += 1;
    }
    regions.push({ organisation, from: from / total, to: (unit - 1) / total });
    unit += gap;
  }
  return { found, regions };
}

function point(shape, turn, stretch = 1) {
  const angle = Math.PI + turn * 2 * Math.PI;
  return { x: shape.width / 2 + shape.rx * stretch * Math.cos(angle), y: shape.height / 2 + shape.ry * stretch * Math.sin(angle) };
}

function layOut(svg, state, onNode, onLink) {
  const { network, shape } = state;
  const { found, regions } = places(network, shape);
  svg.setAttribute("viewBox", `0 0 ${shape.width} ${shape.height}`);
  state.links.clear();
  const backs = regions.map((region) => drawRegion(shape, region));
  const lines = [];
  const names = network.nodes.map((node) => node.name);
  const isBoth = !isMany(network);
  for (const from of names) {
    for (const to of names) {
      if (from === to || (!isBoth && from > to)) continue;
      const link = drawLink(found.get(from), found.get(to), shape.radius, isBoth, () => onLink?.(from, to));
      state.links.set(`${from} ${to}`, link);
      lines.push(link.group);
    }
  }
  const dots = network.nodes.map((node) => drawNode(state.nodes.get(node.name, () => makeNode(node.name, onNode)), node, found.get(node.name), shape));
  state.nodes.keep(names);
  replace(svg.children[0], backs);
  replace(svg.children[1], lines);
  arrange(svg.children[2], dots);
}

function drawRegion(shape, { organisation, from, to }) {
  const steps = Math.max(1, Math.round((to - from) * 48));
  const points = Array.from({ length: steps + 1 }, (_, step) => point(shape, from + ((to - from) * step) / steps));
  const path = points.map(({ x, y }, index) => `${index ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`).join("") + (points.length === 1 ? "h0.1" : "");
  const middle = point(shape, (from + to) / 2);
  const isSide = Math.abs(middle.x - shape.width / 2) > shape.rx * 0.5;
  const x = isSide ? (middle.x < shape.width / 2 ? 8 : shape.width - 8) : middle.x;
  const y = middle.y < shape.height / 2 - 1 || isSide ? 18 : shape.height - 8;
  return s("g", { class: "region" },
    s("path", { d: path, "stroke-width": shape.region }),
    s("text", { x, y, "text-anchor": isSide ? (x < shape.width / 2 ? "start" : "end") : "middle" }, organisation));
}

function drawLink(a, b, radius, isBoth, onClick) {
  const length = Math.hypot(b.x - a.x, b.y - a.y) || 1;
  const ux = (b.x - a.x) / length;
  const uy = (b.y - a.y) / length;
  const aside = isBoth ? 5 : 0;
  const start = { x: a.x + ux * (radius + 5) - uy * aside, y: a.y + uy * (radius + 5) + ux * aside };
  const end = { x: b.x - ux * (radius + 5) - uy * aside, y: b.y - uy * (radius + 5) + ux * aside };
  const d = `M${start.x.toFixed(1)} ${start.y.toFixed(1)}L${end.x.toFixed(1)} ${end.y.toFixed(1)}`;
  const title = s("title", {});
  const line = s("path", { class: "wire", d });
  const flow = s("path", { class: "flow", d });
  const middle = { x: start.x + (end.x - start.x) * 0.4, y: start.y + (end.y - start.y) * 0.4 };
  const mark = s("text", { class: "mark", x: middle.x.toFixed(1), y: (middle.y + 5).toFixed(1), "text-anchor": "middle" });
  const group = s("g", { class: "link", onclick: onClick }, title, s("path", { class: "reach", d }), line, flow, mark);
  return { group, flow, mark, title };
}

/** What of a node stays, however it is drawn: what is pressed and has the focus. */
function makeNode(name, onNode) {
  const press = (event) => {
    if (event.type === "keydown" && event.key !== "Enter" && event.key !== " ") return;
    event.preventDefault();
    onNode?.(name);
  };
  const reacts = onNode ? { role: "button", tabindex: 0, onclick: press, onkeydown: press } : { role: "img" };
  return { group: s("g", { class: "node", ...reacts }) };
}

/** Draw a node at its place; return its group. */
function drawNode(drawn, node, { x, y }, shape) {
  const { radius } = shape;
  const body = node.producer ? s("circle", { class: "body", r: radius })
    : s("rect", { class: "body", x: -radius, y: -radius, width: 2 * radius, height: 2 * radius, rx: 8 });
  const figure = s("text", { class: "figure-text", y: 5, "text-anchor": "middle" });
  const below = s("text", { class: "state-text", y: radius + 33, "text-anchor": "middle" });
  const crown = s("g", { class: "crown", transform: `translate(0 ${-radius - 12})` },
    s("rect", { x: -22, y: -10, width: 44, height: 17, rx: 8 }), s("text", { y: 3, "text-anchor": "middle" }, "leads"));
  const group_mark = s("text", { class: "group-text", x: -radius - 4, y: -radius + 6, "text-anchor": "middle" });
  const title = s("title", {});
  drawn.group.setAttribute("transform", `translate(${x.toFixed(1)} ${y.toFixed(1)})`);
  replace(drawn.group, title, s("circle", { class: "halo", r: radius + 7 }), body, figure,
    s("text", { class: "name-text", y: radius + 20, "text-anchor": "middle" }, node.name), below,
    node.custodian && s("g", { class: "safe", transform: `translate(${radius - 3} ${radius - 8})` },
      s("rect", { x: -9, y: -8, width: 18, height: 16, rx: 3 }), s("circle", { r: 3.5 })),
    crown, group_mark);
  Object.assign(drawn, { figure, below, title, group_mark, facts: node });
  return drawn.group;
}

function show(state) {
  const { moment } = state;
  const leads = leaderOf(moment)?.leader;
  for (const node of moment.nodes) {
    const drawn = state.nodes.find(node.name);
    if (drawn) showNode(drawn, node, leads === node.name, state);
  }
  const names = state.network.nodes.map((node) => node.name);
  const links = allLinks(moment, names);
  for (const [key, drawn] of state.links) showLink(drawn, links.get(key), !isMany(state.network) ? null : links.get(key.split(" ").reverse().join(" ")));
}

function showNode(drawn, node, isLeader, state) {
  const group = state.groups?.get(node.name);
  drawn.group.setAttribute("class", `node ${toneOf(node)}${isLeader ? " leads" : ""}${state.selected === node.name ? " selected" : ""}${group === undefined ? "" : ` group-${group % GROUPS_MAX_COUNT}`}`);
  drawn.figure.textContent = node.final ?? "";
  const wrong = node.disks ? "disk full" : node.clock_set_ms ? "wrong clock" : "";
  const words = node.state === "signing" && !node.behaviour ? wrong : stateWords(node);
  drawn.below.textContent = words.length > 22 ? `${words.slice(0, 21)}…` : words;
  drawn.group_mark.textContent = group === undefined ? "" : String.fromCharCode(65 + group);
  const roles = [drawn.facts.producer && "producer", drawn.facts.custodian && "custodian"].filter(Boolean).join(" and ") || "neither producer nor custodian";
  const sentence = `${node.name} of ${drawn.facts.organisation}, ${roles}: ${[stateWords(node), stateReason(node)].filter(Boolean).join(", ")}${isLeader ? ", leads" : ""}, final height ${node.final ?? "unknown"}${node.faults ? `; ${node.faults.join("; ")}` : ""}${group === undefined ? "" : `; in group ${String.fromCharCode(65 + group)}`}`;
  drawn.title.textContent = sentence;
  drawn.group.setAttribute("aria-label", sentence);
}

const MARKS = { cut: "✕", lossy: "?", slow: "…", narrow: "=" };

function showLink(drawn, link, back) {
  const worst = back && back.state !== "up" ? back : link;
  drawn.group.setAttribute("class", `link ${worst.state}`);
  drawn.mark.textContent = MARKS[worst.state] ?? "";
  const arrived = (link.arrived ?? 0) + (back?.arrived ?? 0);
  const pace = arrived <= 0 ? "" : arrived < 3 ? "slow-pace" : arrived < 30 ? "mid-pace" : "fast-pace";
  drawn.flow.setAttribute("class", `flow ${pace}`);
  drawn.title.textContent = back ? `${linkSentence(link)}. ${linkSentence(back)}` : linkSentence(link);
}
