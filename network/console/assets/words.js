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
  return ["waiting", "paused", "suspended"].includes(node.state) ? "warn" : "bad";
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

/** The most of these producers that can hear of each other, however indirectly and in whichever direction. */
function largestGroup(moment, taking) {
  const awake = moment.nodes.filter((node) => !["stopped", "paused"].includes(node.state)).map((node) => node.name);
  const cut = new Set(moment.links.filter((link) => link.state === "cut").map((link) => `${link.from} ${link.to}`));
  const left = new Set(awake);
  let largest = 0;
  for (const first of awake) {
    if (!left.delete(first)) continue;
    const group = [first];
    for (const name of group) {
      for (const other of left) {
        if (cut.has(`${name} ${other}`) && cut.has(`${other} ${name}`)) continue;
        left.delete(other);
        group.push(other);
      }
    }
    largest = Math.max(largest, group.filter((name) => taking.has(name)).length);
  }
  return largest;
}

/** How the whole is: {tone, title, text}. */
export function verdict(moment, network) {
  const producers = new Set(network.nodes.filter((node) => node.producer).map((node) => node.name));
  const able = new Set(moment.nodes.filter((node) => producers.has(node.name) && ["signing", "suspended"].includes(node.state)).map((node) => node.name));
  const taking = able.size;
  const share = `${taking} of ${producers.size} producers take part; a quorum is ${network.quorum}.`;
  const cut = new Set(moment.links.filter((link) => link.state === "cut").map((link) => link.from));
  const isSplit = cut.size > 0 && taking >= network.quorum && largestGroup(moment, able) < network.quorum;
  const split = `Links are cut, and no group has a quorum, ${network.quorum} of ${producers.size} producers: nothing can become final until they are healed.`;
  if (moment.stuck_since_ms !== null) {
    const why = isSplit ? split : cut.size && taking >= network.quorum ? "Links are cut: perhaps no quorum hears of each other." : share;
    return { tone: "bad", title: "Nothing becomes final", text: `Work has waited for ${formatDuration(moment.at_ms - moment.stuck_since_ms)}. ${why}` };
  }
  if (taking < network.quorum) return { tone: "bad", title: "No quorum", text: `${share} Nothing can become final; nothing that was final is lost.` };
  if (isSplit) return { tone: "bad", title: "No quorum", text: `${split} Nothing that was final is lost.` };
  if (taking < producers.size) return { tone: "warn", title: "It goes on", text: share };
  if (cut.size) return { tone: "warn", title: "Links are cut", text: share };
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
