// Replays an exported run in a file of its own: a slider over its moments, the same pictures as the live page.

import { h, replace } from "./shared/dom.js";
import { formatDuration, formatTime, plural, zoneName } from "./shared/format.js";
import { createEvents } from "./events.js";
import { createStage } from "./stage.js";
import { createTimeline } from "./timeline.js";

const ROUNDS_SHOWN_COUNT = 24;
const root = document.getElementById("root");
const read = (id) => JSON.parse(document.getElementById(id).textContent);

/** The place of what was the newest at a time. */
function indexAt(entries, ms) {
  let low = 0;
  let high = entries.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (entries[middle].at_ms <= ms) low = middle;
    else high = middle - 1;
  }
  return low;
}

function build(facts, moments) {
  const { network, networks } = facts;
  const from = moments[0].at_ms;
  const to = Math.max(moments.at(-1).at_ms, facts.events.at(-1)?.at_ms ?? 0, from + 1);
  const stage = createStage({ network, beside: null });
  const show = (ms) => {
    const moment = moments[indexAt(moments, ms)];
    const its = networks.length ? networks[indexAt(networks, moment.at_ms)].network : network;
    stage.update({ ...moment, at_ms: Math.max(moment.at_ms, ms) }, facts.rounds.filter((round) => round.at_ms <= ms).slice(-ROUNDS_SHOWN_COUNT), its);
  };
  const timeline = createTimeline({ from, to, events: facts.events, onShow: show });
  const events = createEvents({ names: facts.recording.names, onPick: (event) => timeline.goTo(event.at_ms) });
  events.set(facts.events);
  const dropped = facts.recording.dropped.words;
  replace(root, h("header", { class: "bar" }, h("span", { class: "brand" }, "BlockRobot"), h("span", { class: "quiet" }, "a recorded run")),
    h("main", { class: "page wide", id: "main", tabindex: -1 }, h("h1", {}, `A run of ${network.name}`),
      h("p", { class: "quiet" }, `From ${formatTime(from)} for ${formatDuration(to - from)}: ${plural(moments.length, "moment", "moments")}, ${plural(facts.events.length, "event", "events")}, exported ${formatTime(facts.exported_ms)}. Times are in your own time zone, ${zoneName()}. ${dropped}`),
      timeline.element,
      stage.element,
      h("section", { class: "card", "aria-labelledby": "events-title" }, h("h2", { id: "events-title" }, "What happened"), events.element)));
  show(to);
}

const moments = read("moments");
if (moments.length) build(read("facts"), moments);
else replace(root, h("main", { class: "page", id: "main" }, h("h1", {}, "An empty run"), h("p", {}, "Nothing was recorded before this file was made.")));
