// The line of time of a run: a slider over it, steps from event to event, marks where something happened. The live page and
// a replay share it. Must never move by itself once somebody looks at the past, but by Play.

import { focusOn, h, replace } from "./shared/dom.js";
import { formatClock, formatDuration, zoneOffset } from "./shared/format.js";
import { ROUTINE_KINDS } from "./words.js";

const FRAME_MS = 100;
const SPEEDS = [1, 4, 16];
const MARKS_MAX_COUNT = 1000;

/**
 * {element, isAtEnd(), goTo(ms), extend(to, events)}; `onShow(ms, isAtEnd)` is called with each moment that is looked at.
 * `live`: the end is now, and goes on. Events are oldest first.
 */
export function createTimeline({ from, to, events, onShow, live = false }) {
  const state = { from, to, at: to, playing: null, speed: 1, notable: [] };
  const time = h("output", { for: "slider", class: "mono" });
  const slider = h("input", { type: "range", id: "slider", min: 0, step: FRAME_MS, oninput: () => { stop(); go(state.from + Number(slider.value)); } });
  const play = h("button", { type: "button", class: live ? "" : "primary", onclick: () => (state.playing ? stop() : start()) }, "Play");
  const now = live && h("button", { type: "button", onclick: () => { stop(); go(state.to); } }, "Back to now");
  const speed = h("select", { id: "speed", onchange: () => { state.speed = Number(speed.value); } }, SPEEDS.map((times) => h("option", { value: times }, times === 1 ? "as it was" : `${times} times`)));
  const track = h("div", { class: "marks", "aria-hidden": "true" });
  const latest = h("p", { class: "latest" });
  const element = h("section", { class: "card replay", "aria-label": live ? "Line of time" : "Replay" },
    h("div", { class: "row no-print" }, play, h("button", { type: "button", onclick: () => jump(-1) }, "Event before"), h("button", { type: "button", onclick: () => jump(1) }, "Next event"),
      h("label", { for: "speed" }, "Speed"), speed, now),
    h("label", { for: "slider" }, "Moment ", time), slider, track, latest);
  const isAtEnd = () => state.at >= state.to;

  function tell() {
    slider.max = Math.ceil((state.to - state.from) / FRAME_MS) * FRAME_MS;
    slider.value = isAtEnd() ? slider.max : state.at - state.from;
    const place = live && isAtEnd() ? "now" : `${formatDuration(state.at - state.from)} of ${formatDuration(state.to - state.from)}`;
    const words = `${formatClock(state.at)} ${zoneOffset(state.at)}, ${place}`;
    if (time.textContent !== words) time.textContent = words;
    slider.setAttribute("aria-valuetext", words);
    if (now) now.setAttribute("aria-disabled", String(isAtEnd()));
    element.classList.toggle("past", live && !isAtEnd());
    const last = state.notable.findLast((event) => event.at_ms <= state.at);
    const warning = live && !isAtEnd() ? "You look at the past; what you break is broken now. " : "";
    replace(latest, warning, last ? `${formatClock(last.at_ms)} ${zoneOffset(last.at_ms)}  ${last.text}` : "");
  }

  function go(ms) {
    state.at = Math.min(state.to, Math.max(state.from, ms));
    tell();
    onShow(state.at, isAtEnd());
  }

  function jump(step) {
    stop();
    const next = step > 0 ? state.notable.find((event) => event.at_ms > state.at) : state.notable.findLast((event) => event.at_ms < state.at);
    go(next ? next.at_ms : step > 0 ? state.to : state.from);
  }

  function start() {
    if (isAtEnd()) state.at = state.from;
    play.textContent = "Stop";
    state.playing = setInterval(() => {
      go(state.at + FRAME_MS * state.speed);
      if (isAtEnd()) stop();
    }, FRAME_MS);
  }

  function stop() {
    clearInterval(state.playing);
    state.playing = null;
    play.textContent = "Play";
  }

  function add(more) {
    state.notable = [...state.notable, ...more.filter((event) => !ROUTINE_KINDS.includes(event.kind))].slice(-MARKS_MAX_COUNT);
    replace(track, state.notable.map((event) => {
      const mark = h("span", { class: `tick ${event.tone}` });
      mark.style.setProperty("left", `${(Math.min(1, (event.at_ms - state.from) / (state.to - state.from))) * 100}%`);
      return mark;
    }));
  }

  add(events);
  tell();
  return {
    element,
    isAtEnd,
    goTo(ms) { stop(); go(ms); focusOn(slider); },
    /** Take what came in; who looks at now goes on looking at now. */
    extend(until, more) {
      const follows = isAtEnd();
      state.to = Math.max(until, state.from + 1);
      if (follows) state.at = state.to;
      add(more);
      tell();
    },
  };
}
