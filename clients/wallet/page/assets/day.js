// One day: what was recorded, by robot and time of day. Two thousand recordings stay quick: rows are made when they come
// into view. Must never leave a recording out of its group.

import { h, replace } from "./shared/dom.js";
import { get } from "./api.js";
import { clock, contentOf, dateOf, dayName, redraw, sensorName, verdictBadge, zone } from "./pieces.js";
import { choose, wishToWatch } from "./selection.js";
import { t } from "./texts.js";

const ROWS_A_PAGE_COUNT = 2_000;
const ROWS_AT_ONCE_COUNT = 40;
const OPEN_AT_ONCE_COUNT = 12;
const PARTS = [[6, "night"], [12, "morning"], [18, "afternoon"], [24, "evening"]];  // as `wallet records --time`

/** Return the part of the day of a moment: night, morning, afternoon or evening. */
export function partOf(ms) {
  const hour = new Date(ms).getHours();
  return PARTS.find(([until]) => hour < until)[1];
}

async function load(day, signal) {
  const rows = [];
  let cursor;
  do {
    const page = await get("records", { day, zone: zone(), limit: ROWS_A_PAGE_COUNT, cursor }, signal);
    rows.push(...page.records);
    cursor = page.next;
  } while (cursor);
  return rows;
}

/** Group rows by robot and part of the day, and within by visit; all in the order of time. */
export function groupRows(rows) {
  const groups = new Map();
  for (const row of rows) {
    const key = `${row.robot} ${partOf(row.started_at_ms)}`;
    if (!groups.has(key)) groups.set(key, { key, robot: row.robot, part: partOf(row.started_at_ms), visits: new Map(), count: 0, notices: 0 });
    const group = groups.get(key);
    if (row.kind === "notice") group.notices += 1;
    else group.count += 1;
    if (!group.visits.has(row.visit)) group.visits.set(row.visit, []);
    group.visits.get(row.visit).push(row);
  }
  return [...groups.values()];
}

/** Show a day (2026-11-22). */
export async function showDay(context, day) {
  let [rows, days] = await Promise.all([load(day, context.signal), get("days", { zone: zone() }, context.signal)]);
  const picked = new Set(context.kept ?? []);
  const opened = new Map();
  const node = h("div", {});
  const actions = h("div", { class: "card row actions", role: "region", "aria-label": t("day.actions") });

  const drawActions = () => {
    actions.hidden = picked.size === 0;
    const title = t("day.picked", { count: picked.size });
    const send = (place) => () => {
      choose({ records: rows.filter((row) => picked.has(row.record_id)).map((row) => row.record_id), title, back: `day/${day}`, backLabel: dayName(dateOf(day).getTime()) });
      context.go(place);
    };
    replace(actions, h("span", { role: "status" }, title), h("button", { type: "button", class: "push", onclick: send("share") }, t("action.share")), h("button", { type: "button", onclick: send("export") }, t("action.export")),
      h("button", { type: "button", class: "danger", onclick: send("erase") }, t("action.erase")),
      h("button", { type: "button", class: "plain", onclick: () => { picked.clear(); draw(); } }, t("day.unpick")));
  };

  const pick = (ids, isOn) => {
    for (const id of ids) isOn ? picked.add(id) : picked.delete(id);
    for (const box of node.querySelectorAll("input[data-record]")) box.checked = picked.has(box.dataset.record);
    for (const box of node.querySelectorAll("input[data-visit]")) mark(box);
    drawActions();
  };

  const mark = (box) => {
    const ids = rows.filter((row) => row.visit === box.dataset.visit && pickable(row)).map((row) => row.record_id);
    const count = ids.filter((id) => picked.has(id)).length;
    box.checked = count > 0 && count === ids.length;
    box.indeterminate = count > 0 && count < ids.length;
  };

  const robotName = (robot) => days.robots.find((one) => one.robot === robot)?.called ?? robot.slice(0, 10);

  const drawGroup = (group, number) => h("section", { class: "card", "aria-labelledby": `group-${number}` },
    h("h2", { id: `group-${number}` }, t(`part.${group.part}`), h("span", { class: "quiet" }, ` · ${t("calendar.robot")} ${robotName(group.robot)} · ${group.count ? t("day.count", { count: group.count }) : t("calendar.notices", { count: group.notices })}`)),
    [...group.visits].map(([visit, own]) => drawVisit(visit, own)));

  const drawVisit = (visit, own) => {
    const usable = own.filter(pickable);
    const body = h("div", { class: "rows" });
    const isOpen = opened.get(visit) ?? rows.length <= OPEN_AT_ONCE_COUNT;
    const box = h("input", { type: "checkbox", "data-visit": visit, "data-key": `pick-${visit}`, "aria-label": t("day.pickVisit", { from: clock(own[0].started_at_ms) }), disabled: usable.length === 0, onchange: (event) => pick(usable.map((row) => row.record_id), event.target.checked) });
    const details = h("details", { class: "visit", ontoggle: () => {
      opened.set(visit, details.open);
      if (details.open && !body.hasChildNodes()) renderLazily(body, own, drawRow);
    } },
    h("summary", { "data-key": `open-${visit}` }, h("span", { class: "span" }, spanOf(own)), " ", h("span", { class: "quiet" }, wordsOf(own)), " ", h("span", { class: "badges" }, badges(own))),
    body);
    mark(box);
    details.open = isOpen;
    return h("div", { class: "visit-row" }, box, details, own.some(watchable) && h("a", { class: "button", "data-key": `watch-${visit}`, href: `#/visit/${visit}/${day}`, onclick: () => wishToWatch(visit), "aria-label": t("day.watchVisit", { from: clock(own[0].started_at_ms) }) }, t("action.watch")));
  };

  const drawRow = (row) => h("div", { class: "record-row" },
    h("input", { type: "checkbox", "data-record": row.record_id, checked: picked.has(row.record_id), disabled: !pickable(row), "aria-label": t("day.pick", { time: clock(row.started_at_ms) }), onchange: (event) => pick([row.record_id], event.target.checked) }),
    h("a", { href: `#/record/${row.record_id}` }, clock(row.started_at_ms)), h("span", {}, contentOf(row)), h("span", { class: "quiet" }, row.kind === "notice" ? "" : sensorName(row.sensor)), h("span", { class: "badges" }, rowBadges(row)));

  const draw = () => replace(node, neighbours(day, days.days), rows.length === 0 && h("div", { class: "card" }, h("p", {}, t("day.empty"))), groupRows(rows).map(drawGroup), actions);

  draw();
  drawActions();
  return { title: dayName(dateOf(day).getTime()), back: { href: "#/", label: t("calendar.title") }, node, keep: () => picked, shows: (id) => rows.some((row) => row.record_id === id), async refresh() {
    [rows, days] = await Promise.all([load(day, context.signal), get("days", { zone: zone() }, context.signal)]);
    redraw(node, draw);
    drawActions();
  } };
}

const pickable = (row) => row.status === "active";
const watchable = (row) => row.status === "active" && !row.denied && row.kind !== "notice";

function spanOf(rows) {
  const from = clock(rows[0].started_at_ms);
  const to = clock(Math.max(...rows.map((row) => row.ended_at_ms)));
  return from === to ? from : t("day.span", { from, to });
}

function wordsOf(rows) {
  const counts = new Map();
  for (const row of rows) if (row.kind !== "notice") counts.set(row.kind, (counts.get(row.kind) ?? 0) + row.frames - row.erased_frames.length);
  const withheld = rows.reduce((sum, row) => sum + Object.values(row.withheld).reduce((all, one) => all + one, 0), 0);
  if (counts.size === 0) return t("content.notice", { count: 1 });
  return [...[...counts].map(([kind, count]) => t(`content.${kind}`, { count })), withheld > 0 && t("content.withheld", { count: withheld })].filter(Boolean).join(" · ");
}

function badges(rows) {
  const real = rows.filter((row) => row.kind !== "notice" && row.status === "active");
  const bad = real.filter((row) => row.verdict === "corrupted").length;
  const good = real.filter((row) => row.verdict === "verified").length;
  const gone = rows.filter((row) => row.status !== "active").length;
  return [bad > 0 && h("span", { class: "badge bad" }, t("verdict.corruptedCount", { count: bad })),
    bad === 0 && real.length > 0 && good === real.length && h("span", { class: "badge good" }, t("verdict.verified")),
    gone > 0 && h("span", { class: "badge warn" }, t("verdict.erasedCount", { count: gone })),
    rows.some((row) => row.shared > 0) && h("span", { class: "badge accent" }, t("badge.shared")),
    rows.some((row) => row.restricted) && h("span", { class: "badge" }, t("badge.restricted")),
    rows.some((row) => row.denied) && h("span", { class: "badge warn" }, t("badge.denied"))];
}

function rowBadges(row) {
  return [row.status === "active" ? verdictBadge(row) : h("span", { class: "badge warn" }, t(`status.${row.status}`)),
    row.shared > 0 && h("span", { class: "badge accent" }, t("badge.shared")), row.restricted && h("span", { class: "badge" }, t("badge.restricted")), row.denied && h("span", { class: "badge warn" }, t("badge.denied"))];
}

function neighbours(day, days) {
  const place = days.findIndex((one) => one.day === day);
  const link = (one, label) => one && h("a", { class: "button", "data-key": label, href: `#/day/${one.day}` }, label);
  if (place < 0) return null;
  return h("nav", { class: "row neighbours", "aria-label": t("day.neighbours") }, link(days[place + 1], `‹ ${t("day.earlier")}`), link(days[place - 1], `${t("day.later")} ›`));
}

/** Make rows as they come into view: some at once, the others when the end of the list is near. */
function renderLazily(body, rows, draw) {
  let made = 0;
  const end = h("div", { class: "more" });
  const more = () => {
    end.before(...rows.slice(made, made + ROWS_AT_ONCE_COUNT).map(draw));
    made += ROWS_AT_ONCE_COUNT;
    if (made >= rows.length) {
      watch.disconnect();
      end.remove();
    } else replace(end, h("button", { type: "button", class: "plain", onclick: more }, t("day.more", { count: rows.length - made })));
  };
  const watch = new IntersectionObserver((seen) => { if (seen.some((one) => one.isIntersecting)) more(); }, { rootMargin: "400px" });
  body.append(end);
  more();
  if (made < rows.length) watch.observe(end);
}
