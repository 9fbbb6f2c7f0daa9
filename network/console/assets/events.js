// The time line of what happened: newest first, filtered by kind, node and word.

import { h, replace } from "./shared/dom.js";
import { formatClock, plural } from "./shared/format.js";
import { arrange } from "./keeping.js";
import { KINDS, ROUTINE_KINDS } from "./words.js";

const SHOWN_COUNT = 200;

/** {element, set(events), add(events), setNames, showUntil(ms or null)}; onPick(event) makes the times buttons. */
export function createEvents({ names, onPick }) {
  const state = { events: [], rows: new WeakMap(), kinds: new Set(Object.keys(KINDS).filter((kind) => !ROUTINE_KINDS.includes(kind))), node: "", text: "", until: null, count: SHOWN_COUNT };
  const list = h("ol", { class: "events", reversed: true });
  const said = h("p", { class: "quiet", role: "status" });
  const more = h("button", { type: "button", hidden: true, onclick: () => { state.count += SHOWN_COUNT; draw(); } }, "Show more");
  const draw = () => show(state, list, said, more, onPick);
  const again = () => { state.count = SHOWN_COUNT; draw(); };
  const kinds = Object.entries(KINDS).map(([kind, name]) => h("label", { class: "chip" },
    h("input", { type: "checkbox", checked: state.kinds.has(kind), onchange: (event) => {
      if (event.target.checked) state.kinds.add(kind);
      else state.kinds.delete(kind);
      again();
    } }), name));
  const select = h("select", { id: "events-node", onchange: (event) => { state.node = event.target.value; again(); } },
    nodeOptions(names));
  const search = h("input", { id: "events-text", type: "search", oninput: (event) => { state.text = event.target.value.toLowerCase(); again(); } });
  const element = h("div", {},
    h("fieldset", { class: "chips no-print" }, h("legend", { class: "visually-hidden" }, "Kinds of events"), kinds),
    h("div", { class: "row filters no-print" },
      h("div", {}, h("label", { for: "events-node" }, "About"), select), h("div", {}, h("label", { for: "events-text" }, "Containing"), search)),
    said, h("div", { class: "events-box", tabindex: 0, role: "region", "aria-label": "What happened, newest first" }, list, more));
  draw();
  return {
    element,
    set(events) { state.events = events; draw(); },
    add(events) {
      if (!events.length) return;
      state.events = [...state.events, ...events].slice(-5000);
      draw();
    },
    showUntil(ms) { state.until = ms; draw(); },
    setNames(all) {
      replace(select, nodeOptions(all));
      if (all.includes(state.node)) select.value = state.node;
      else { state.node = ""; again(); }
    },
  };
}

function nodeOptions(names) {
  return [h("option", { value: "" }, "all nodes"), ...names.map((name) => h("option", { value: name }, name))];
}

function show(state, list, said, more, onPick) {
  const found = state.events.filter((event) => state.kinds.has(event.kind) && (!state.node || event.nodes.includes(state.node))
    && (!state.text || event.text.toLowerCase().includes(state.text)) && (state.until === null || event.at_ms <= state.until));
  const newest = found.slice(-state.count).reverse();
  list.start = found.length;
  arrange(list, newest.map((event) => state.rows.get(event) ?? keep(state.rows, event, row(event, onPick))));
  const words = found.length === state.events.length ? plural(found.length, "event", "events") : `${found.length} of ${plural(state.events.length, "event", "events")}`;
  if (said.textContent !== words) said.textContent = words;
  more.hidden = newest.length === found.length;
}

function keep(rows, event, made) {
  rows.set(event, made);
  return made;
}

function row(event, onPick) {
  const time = formatClock(event.at_ms);
  return h("li", { class: event.tone },
    onPick ? h("button", { type: "button", class: "plain time", title: "Show this moment", onclick: () => onPick(event) }, time) : h("span", { class: "time" }, time),
    h("span", { class: `badge ${event.tone}` }, KINDS[event.kind] ?? event.kind), h("span", { class: "what" }, event.text));
}
