// The live console: opens the session, follows the network, hands what is asked to the server.

import { announce, h, isAtWork, replace, setAtWork } from "./shared/dom.js";
import { fetchBytes, fetchJson, keepOpen, openSession } from "./shared/fetching.js";
import { formatBytes, formatTime, plural, zoneName } from "./shared/format.js";
import { createEvents } from "./events.js";
import { createFaults, showProblem } from "./faults.js";
import { createStage } from "./stage.js";
import { createTimeline } from "./timeline.js";

const RETRY_MS = 2000;
const ANSWER_MS = 20000; // the server holds an answer back for five seconds at most
const root = document.getElementById("root");

function bar(name, ...buttons) {
  return h("header", { class: "bar" }, h("span", { class: "brand" }, "BlockRobot"), h("span", { class: "quiet network-name" }, name), ...buttons);
}

function showEnd(problem) {
  replace(root, bar("Cluster console"), h("main", { class: "page", id: "main", tabindex: -1 }, h("h1", {}, "The console is not open here"),
    h("div", { class: "notice bad" }, h("p", {}, problem.detail), h("p", { class: "quiet" }, `${problem.code}.`)),
    h("p", {}, "A page that was reloaded needs a new link: in the terminal where the console runs, press Enter for another link; or start it with ", h("code", {}, "blockrobot console"), ".")));
}

async function exportRun(event, said) {
  const button = event.currentTarget;
  if (isAtWork(button)) return;
  setAtWork(button, true);
  try {
    const { bytes, headers } = await keepOpen(() => fetchBytes("./api/export", { method: "POST", body: {} }));
    const name = /filename="([\w.-]+)"/.exec(headers.get("Content-Disposition") ?? "")?.[1] ?? "blockrobot-run.html";
    const url = URL.createObjectURL(new Blob([bytes], { type: "text/html" }));
    h("a", { href: url, download: name }).click();
    setTimeout(() => URL.revokeObjectURL(url), 60000);
    replace(said, h("p", { class: "notice good" }, `Exported: ${name}, ${formatBytes(bytes.byteLength)}. Open it with any browser, also without a network.`));
    announce(`Exported as ${name}.`);
  } catch (problem) {
    showProblem(said, problem);
  } finally {
    setAtWork(button, false);
  }
}

/** Show a moment of the past once it is there, unless another one, or now, is wanted by then. */
function createPast(parts) {
  let wanted = 0;
  return async (ms, isNow) => {
    wanted += 1;
    const own = wanted;
    if (isNow) {
      if (parts.newest) parts.stage.update(parts.newest.moment, parts.newest.rounds, parts.newest.network);
      return;
    }
    try {
      const { moment, rounds, network } = await fetchJson(`./api/past?at_ms=${Math.round(ms)}`, { signal: AbortSignal.timeout(ANSWER_MS) });
      if (own === wanted && moment) parts.stage.update({ ...moment, at_ms: Math.max(moment.at_ms, ms) }, rounds, network);
    } catch (problem) {
      if (own === wanted) showProblem(parts.said, problem);
    }
  };
}

function buildPage(first, choices) {
  const network = first.network;
  const said = h("div", { class: "said" });
  let parts = null;
  const select = (name) => { parts.stage.setSelected(name); };
  const onNode = (name) => {
    if (!parts.faults.isOfToday(name)) return;
    if (parts.faults.isGrouping()) { parts.faults.toggleGroup(name); return; }
    select(name);
    parts.faults.select(name);
  };
  const faults = createFaults({ network, choices, onSelect: select, onGroups: (groups) => parts?.stage.topology.setGroups(groups) });
  const stage = createStage({ network, onNode, onLink: (from, to) => faults.selectLink(from, to), beside: faults.element });
  const events = createEvents({ names: first.recording.names, onPick: (event) => parts.timeline.goTo(event.at_ms) });
  const recording = h("p", { class: "quiet recording" });
  parts = { stage, faults, events, recording, said, folder: choices.folder, newest: null };
  const from = first.recording.since_ms;
  parts.timeline = createTimeline({ from, to: Math.max(first.moment?.at_ms ?? 0, from + 1), events: [], live: true, onShow: createPast(parts) });
  const exporting = h("button", { type: "button", onclick: (event) => exportRun(event, said) }, "Export the run");
  replace(root, bar(network.name, exporting),
    h("main", { class: "page wide", id: "main", tabindex: -1 }, h("h1", {}, "Cluster console"), said, h("div", { class: "lost", role: "alert" }), stage.element[0], parts.timeline.element, stage.element.slice(1),
      h("section", { class: "card", "aria-labelledby": "events-title" }, h("h2", { id: "events-title" }, "What happened"), events.element, recording)));
  return parts;
}

function show(parts, answer) {
  if (answer.moment) {
    parts.newest = answer;
    parts.timeline.extend(answer.moment.at_ms, answer.events);
    parts.faults.update(answer.moment);
    if (parts.timeline.isAtEnd()) parts.stage.update(answer.moment, answer.rounds, answer.network);
  }
  parts.events.add(answer.events);
  parts.faults.showPlan(answer.plan);
  for (const event of answer.events) if (event.tone === "bad" || event.kind === "finality") announce(event.text);
  const kept = answer.recording;
  const words = `The network in ${parts.folder}, recorded since ${formatTime(kept.since_ms)}: ${plural(kept.moments, "moment", "moments")}, ${formatBytes(kept.size_bytes)}. ${kept.dropped.words} Times are in your own time zone, ${zoneName()}.`;
  if (parts.recording.textContent !== words) parts.recording.textContent = words;
}

async function follow(parts, first) {
  let sequence = first.sequence;
  let number = first.events.at(-1)?.number ?? 0;
  let shape = JSON.stringify(first.network);
  const lost = document.querySelector(".lost");
  for (;;) {
    try {
      const answer = await fetchJson(`./api/now?after=${sequence}&events=${number}`, { signal: AbortSignal.timeout(ANSWER_MS) });
      if (lost.firstChild) replace(lost);
      sequence = answer.sequence;
      number = answer.events.at(-1)?.number ?? number;
      const changed = JSON.stringify(answer.network);
      if (changed !== shape) {
        shape = changed;
        parts.faults.setNetwork(answer.network);
        parts.events.setNames(answer.recording.names);
      }
      show(parts, answer);
    } catch (problem) {
      if (problem.status === 401 || problem.status === 403) { showEnd(problem); return; }
      if (!lost.firstChild) replace(lost, h("p", { class: "notice bad" }, `${problem.detail ?? problem} ${problem.nextStep ?? ""} What is shown may be old. This page asks again every ${RETRY_MS / 1000} seconds.`));
      await new Promise((resolve) => { setTimeout(resolve, RETRY_MS); });
    }
  }
}

async function begin() {
  try {
    await openSession("./session");
    const choices = await fetchJson("./api/choices");
    const first = await fetchJson("./api/now?after=0&events=0");
    const parts = buildPage(first, choices);
    show(parts, first);
    await follow(parts, first);
  } catch (problem) {
    showEnd(problem.code ? problem : { detail: String(problem), code: "INTERNAL", nextStep: "Open the page by a new link." });
  }
}

begin();
