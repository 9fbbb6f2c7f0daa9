// Words and tones for what a moment holds. Pure: the live page and a replay say the same of the same.

import { formatDuration } from "./shared/format.js";

/** What each kind of event is called. The last two are routine and hidden at first. */
export const KINDS = {
  asked: "asked here", fault: "faults", node: "nodes", timeout: "timeouts", suspension: "suspensions",
  finality: "finality", epoch: "epochs", leader: "leaders", link: "connections",
};
const IDLE_AFTER_MS = 5000;
export const ROUTINE_KINDS = ["leader", "link"];

export const LINK_WORDS = {
  up: "up", cut: "cut", lossy: "lossy", slow: "delayed", narrow: "narrow", still: "an end is paused", down: "not connected",
};

/** The tone of a node's state. */
export function toneOf(node) {
  if (node.state === "signing") return node.behaviour ? "warn" : "good";
  return ["waiting", "paused", "suspended", "removed"].includes(node.state) ? "warn" : "bad";
}

/** A node's state in a word or two, lies included. */
export function stateWords(node) {
  return node.behaviour && node.state === "signing" ? "lying" : node.state.split(":")[0];
}

/** Why a node is as it is, in its own words; empty where a word says all. */
export function stateReason(node) {
  return node.state.includes(":") ? node.state.slice(node.state.indexOf(":") + 1).trim() : "";
}

/** How far a clock is off, if that says anything. */
export function clockWords(node) {
  const off = node.clock_off_ms;
  if (off === undefined) return "-";
  if (Math.abs(off) < 500) return "right";
  return `${off > 0 ? "+" : "-"}${formatDuration(Math.abs(off))}`;
}

export function disksWords(node) {
  return node.disks ? `${node.disks.join(", ")} full` : node.state === "stopped" ? "-" : "free";
}

/** Who leads by the words of the node that is in the highest round; `leader` is null while that one is stopped: nobody does. */
export function leaderOf(moment) {
  let best = null;
  for (const node of moment.nodes) {
    if (node.leader === undefined || node.round === undefined) continue;
    const place = (node.epoch ?? 0) * 2 ** 32 + node.round;
    if (best === null || place > best.place) best = { place, leader: node.leader, round: node.round, epoch: node.epoch };
  }
  if (best && moment.nodes.some((node) => node.name === best.leader && node.state === "stopped")) best.leader = null;
  return best;
}

/** Groups of names that can reach each other along links that nobody cut, however indirectly; or `isBothWays` false: one way. */
function groupsOf(names, isCut, isBothWays) {
  const leads = (from, to) => !isCut(from, to) || (!isBothWays && !isCut(to, from));
  const reached = new Map(names.map((first) => {
    const found = new Set([first]);
    for (const name of found) for (const other of names) if (leads(name, other)) found.add(other);
    return [first, found];
  }));
  const groups = [];
  for (const name of names) {
    const own = groups.find((group) => reached.get(name).has(group[0]) && reached.get(group[0]).has(name));
    if (own) own.push(name);
    else groups.push([name]);
  }
  return groups;
}

/** How many of these producers can reach each other, where the most can; how many might, one way being enough; who stands apart. */
function reachOf(moment, able) {
  const awake = moment.nodes.filter((node) => !["stopped", "paused"].includes(node.state)).map((node) => node.name);
  const cut = new Set(moment.links.filter((link) => link.state === "cut").map((link) => `${link.from} ${link.to}`));
  const isCut = (from, to) => cut.has(`${from} ${to}`);
  const countIn = (group) => group.filter((name) => able.has(name)).length;
  const largest = (groups) => groups.reduce((best, group) => (countIn(group) > countIn(best) ? group : best), []);
  const main = largest(groupsOf(awake, isCut, true));
  return { isCut: cut.size > 0, together: countIn(main), perhaps: countIn(largest(groupsOf(awake, isCut, false))), apart: awake.filter((name) => !main.includes(name)) };
}

function listed(names) {
  return names.length > 1 ? `${names.slice(0, -1).join(", ")} and ${names.at(-1)}` : names[0];
}

/** How many producers take part; where links are cut, how many reach each other, and who does not. */
function shareWords({ apart, together }, taking, all, quorum) {
  if (!apart.length) return `${taking} of ${all} producers take part; a quorum is ${quorum}.`;
  if (together < quorum) return `${together} of ${all} producers reach each other both ways; a quorum is ${quorum}.`;
  return `${together} of ${all} producers reach each other; a quorum is ${quorum}. ${listed(apart)} ${apart.length > 1 ? "stand" : "stands"} apart.`;
}

/** Which nodes lie, by the switch, or by what others prove of them; null if none does. */
function liarWords(nodes) {
  const suspended = nodes.filter((node) => node.state === "suspended").map((node) => node.name);
  const lying = nodes.filter((node) => node.behaviour || (node.accused && !suspended.includes(node.name))).map((node) => node.name);
  if (lying.length) return { tone: "bad", title: lying.length > 1 ? "Nodes lie" : "A node lies", text: `${listed(lying)} ${lying.length > 1 ? "do" : "does"} not keep to the protocol${suspended.length ? `; ${listed(suspended)} suspended` : ""}. Nobody is deceived as long as fewer than a third do.` };
  if (suspended.length) return { tone: "warn", title: suspended.length > 1 ? "Nodes are suspended" : "A node is suspended", text: `${listed(suspended)} contradicted ${suspended.length > 1 ? "themselves" : "itself"}, and may not lead until a majority of the organisations brings it back.` };
  return null;
}

/** How the whole is: {tone, title, text}. */
export function verdict(moment, network) {
  const producers = new Set(network.nodes.filter((node) => node.producer).map((node) => node.name));
  const able = new Set(moment.nodes.filter((node) => producers.has(node.name) && ["signing", "suspended"].includes(node.state)).map((node) => node.name));
  const taking = able.size;
  const isEnough = taking >= network.quorum;
  const reach = reachOf(moment, able);
  const isSplit = reach.isCut && isEnough && reach.perhaps < network.quorum;
  const isDoubtful = reach.isCut && isEnough && reach.together < network.quorum;
  const share = isEnough ? shareWords(reach, taking, producers.size, network.quorum) : `${taking} of ${producers.size} producers take part; a quorum is ${network.quorum}.`;
  const split = `Links are cut, and no group has a quorum, ${network.quorum} of ${producers.size} producers: nothing can become final until they are healed.`;
  if (moment.stuck_since_ms !== null) {
    const why = isSplit ? split : reach.isCut && isEnough ? "Links are cut: perhaps no quorum hears of each other." : share;
    return { tone: "bad", title: "Nothing becomes final", text: `Work has waited for ${formatDuration(moment.at_ms - moment.stuck_since_ms)}. ${why}` };
  }
  if (!isEnough) return { tone: "bad", title: "No quorum", text: `${share} Nothing can become final; nothing that was final is lost.` };
  if (isSplit) return { tone: "bad", title: "No quorum", text: `${split} Nothing that was final is lost.` };
  if (isDoubtful) return { tone: "warn", title: "Links are cut", text: `${share} Perhaps nothing more becomes final.` };
  const liar = liarWords(moment.nodes);
  if (liar) return { ...liar, text: `${liar.text} ${share}` };
  if (taking < producers.size) return { tone: "warn", title: "It goes on", text: share };
  if (reach.isCut) return { tone: "warn", title: "Links are cut", text: share };
  const isIdle = moment.at_ms - moment.final_since_ms > IDLE_AFTER_MS && !moment.nodes.some((node) => node.waiting);
  return { tone: "good", title: "All is well", text: isIdle ? `${share} Nothing waits: give it work, such as a robot.` : share };
}

/** One direction of a link, in a sentence. */
export function linkSentence(link) {
  const rate = link.sent === undefined ? "quiet" : `${link.sent} frames/s sent, ${link.arrived} arrive`;
  const kinds = link.kinds && Object.keys(link.kinds).length
    ? ` (${Object.entries(link.kinds).map(([kind, count]) => `${kind.replace("_", " ")} ${count}`).join(", ")})` : "";
  return `${link.from} to ${link.to}: ${LINK_WORDS[link.state]}${link.words && link.words !== "cut" ? ` (${link.words})` : ""}, ${rate}${kinds}`;
}

/** All directions, those that are up and quiet included, by "from to". */
export function allLinks(moment, names) {
  const links = new Map();
  for (const from of names) for (const to of names) if (from !== to) links.set(`${from} ${to}`, { from, to, state: "up" });
  for (const link of moment.links) links.set(`${link.from} ${link.to}`, link);
  return links;
}
