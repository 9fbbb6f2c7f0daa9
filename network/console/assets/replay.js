// Replays an exported run in a file of its own: a slider over its moments, the same pictures as the live page.

import { h, replace } from "./shared/dom.js";
import { formatClock, formatDuration, formatTime, plural } from "./shared/format.js";
import { createEvents } from "./events.js";
import { createStage } from "./stage.js";
import { ROUTINE_KINDS } from "./words.js";

const FRAME_MS = 100;
const SPEEDS = [1, 4, 16];
const ROUNDS_SHOWN_COUNT = 24;
const root = document.getElementById("root");
const read = (id) => JSON.parse(document.getElementById(id).textContent);

function indexAt(moments, ms) {
  let low = 0;
  let high = moments.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (moments[middle].at_ms <= ms) low = middle;
    else high = middle - 1;
  }
  return low;
}

function build(facts, moments) {
  const { network } = facts;
  const from = moments[0].at_ms;
  const to = Math.max(moments.at(-1).at_ms, facts.events.at(-1)?.at_ms ?? 0, from + 1);
  const state = { at: to, playing: null, speed: 1 };
  const stage = createStage({ network, beside: null });
  const time = h("output", { for: "slider", class: "mono" });
  const slider = h("input", { type: "range", id: "slider", min: 0, max: Math.ceil((to - from) / 100) * 100, step: 100, value: to - from, oninput: () => { stop(); go(from + Number(slider.value)); } });
  const play = h("button", { type: "button", class: "primary", onclick: () => (state.playing ? stop() : start()) }, "Play");
  const speed = h("select", { id: "speed", onchange: () => { state.speed = Number(speed.value); } }, SPEEDS.map((times) => h("option", { value: times }, `${times} times`)));
  const events = createEvents({ network, onPick: (event) => { stop(); go(event.at_ms); slider.focus(); } });
  events.set(facts.events);
  const notable = facts.events.filter((event) => !ROUTINE_KINDS.includes(event.kind));
  const jump = (step) => {
    stop();
    const next = step > 0 ? notable.find((event) => event.at_ms > state.at) : notable.findLast((event) => event.at_ms < state.at);
    go(next ? next.at_ms : step > 0 ? to : from);
  };
  function go(ms) {
    state.at = Math.min(to, Math.max(from, ms));
    const moment = moments[indexAt(moments, state.at)];
    slider.value = state.at >= to ? slider.max : state.at - from;
    const words = `${formatClock(state.at)}, ${formatDuration(state.at - from)} of ${formatDuration(to - from)}`;
    time.textContent = words;
    slider.setAttribute("aria-valuetext", words);
    stage.update({ ...moment, at_ms: Math.max(moment.at_ms, state.at) }, facts.rounds.filter((round) => round.at_ms <= state.at).slice(-ROUNDS_SHOWN_COUNT));
    const last = notable.findLast((event) => event.at_ms <= state.at);
    replace(latest, last ? `${formatClock(last.at_ms)}  ${last.text}` : "");
  }
  function start() {
    if (state.at >= to) state.at = from;
    play.textContent = "Stop";
    state.playing = setInterval(() => {
      go(state.at + FRAME_MS * state.speed);
      if (state.at >= to) stop();
    }, FRAME_MS);
  }
  function stop() {
    clearInterval(state.playing);
    state.playing = null;
    play.textContent = "Play";
  }
  const latest = h("p", { class: "latest" });
  const dropped = facts.recording.dropped.words;
  replace(root, h("header", { class: "bar" }, h("span", { class: "brand" }, "BlockRobot"), h("span", { class: "quiet" }, "a recorded run")),
    h("main", { class: "page wide", id: "main", tabindex: -1 }, h("h1", {}, `A run of ${network.name}`),
      h("p", { class: "quiet" }, `From ${formatTime(from)} for ${formatDuration(to - from)}: ${plural(moments.length, "moment", "moments")}, ${plural(facts.events.length, "event", "events")}, exported ${formatTime(facts.exported_ms)}. ${dropped}`),
      h("section", { class: "card replay", "aria-label": "Replay" },
        h("div", { class: "row no-print" }, play, h("button", { type: "button", onclick: () => jump(-1) }, "Event before"), h("button", { type: "button", onclick: () => jump(1) }, "Next event"),
          h("label", { for: "speed" }, "Speed"), speed),
        h("label", { for: "slider" }, "Moment ", time), slider, marks(notable, from, to), latest),
      stage.element,
      h("section", { class: "card", "aria-labelledby": "events-title" }, h("h2", { id: "events-title" }, "What happened"), events.element)));
  go(to);
}

/** Where on the slider something happened: one mark an event, good, bad or neither. */
function marks(events, from, to) {
  const track = h("div", { class: "marks", "aria-hidden": "true" });
  for (const event of events.slice(-1000)) {
    const mark = h("span", { class: `tick ${event.tone}` });
    mark.style.setProperty("left", `${((event.at_ms - from) / (to - from)) * 100}%`);
    track.append(mark);
  }
  return track;
}

const moments = read("moments");
if (moments.length) build(read("facts"), moments);
else replace(root, h("main", { class: "page", id: "main" }, h("h1", {}, "An empty run"), h("p", {}, "Nothing was recorded before this file was made.")));
