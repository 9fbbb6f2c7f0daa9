// The audit trail as a story: one sentence for each event, day by day. Must never leave an event out of what it was given.

import { h, replace } from "./shared/dom.js";
import { get } from "./api.js";
import { clock, dateOf, dayName, dayOf, purposeName, redraw } from "./pieces.js";
import { said, t } from "./texts.js";

const EVENTS_COUNT = 100;

/** Say one event in the reader's language; what the catalogue has no words for is said as the program says it. */
export function tell(event) {
  const data = event.data ?? {};
  const values = {
    ...data,
    count: data.records?.length ?? data.records ?? data.record_count ?? data.destroyed_frames ?? data.findings?.length ?? 0,
    changed: data.findings?.filter((finding) => finding[1] === "corrupted").length ?? 0,
    purpose: data.purpose ? purposeName(data.purpose) : "",
    purposes: (data.purposes ?? []).map((code) => purposeName(code)).join(", "),
    custodian: data.custodian_name ?? "",
    pictures: data.destroyed_frames ?? data.frames?.length ?? 0,
  };
  return said(`story.${variant(event.kind, data)}`, event.sentence, values);
}

function variant(kind, data) {
  if (kind === "verdict") return `verdict_${data.verdict}`;
  if (kind === "access_requested" && (data.grant || !data.records)) return `access_requested_${data.grant ? "shared" : "meeting"}`;
  if (kind === "erasure_requested" && data.frames?.length) return "erasure_requested_frames";
  return kind;
}

/** A list of events, newest first, under headings of their days. */
export function storyList(events, level = 3) {
  if (events.length === 0) return h("p", { class: "quiet" }, t("story.empty"));
  const days = new Map();
  for (const event of events) {
    const day = dayOf(event.time_ms);
    if (!days.has(day)) days.set(day, []);
    days.get(day).push(event);
  }
  return [...days].map(([day, own]) => h("div", { class: "story-day" }, h(`h${level}`, {}, dayName(dateOf(day).getTime())),
    h("ol", { class: "story" }, own.map((event) => h("li", { class: event.tone ?? "quiet" }, h("time", { datetime: new Date(event.time_ms).toISOString() }, clock(event.time_ms)),
      h("span", {}, tell(event), " ", h("span", { class: "quiet block" }, t("story.block", { height: event.height }))))))));
}

/** Show all that happened, of all visits. */
export async function showStory(context) {
  let events = [];
  let page = await get("audit-events", { limit: EVENTS_COUNT }, context.signal);
  events = page.events;
  const list = h("div", {});
  const more = h("p", {});
  const draw = () => {
    replace(list, h("section", { class: "card" }, storyList(events, 2)));
    replace(more, page.next && h("button", { type: "button", "data-key": "more", onclick: load }, t("story.more", { count: page.total - events.length })));
  };
  const load = async () => {
    page = await get("audit-events", { limit: EVENTS_COUNT, cursor: page.next }, context.signal);
    events = [...events, ...page.events];
    redraw(node, draw);
  };
  const node = h("div", {}, h("p", { class: "lead" }, t("story.lead")), list, more);
  draw();
  return { title: t("story.title"), node, async refresh() {
    const first = await get("audit-events", { limit: Math.max(EVENTS_COUNT, events.length) }, context.signal);
    page = first;
    events = first.events;
    redraw(node, draw);
  } };
}
