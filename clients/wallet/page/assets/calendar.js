// The calendar of days on which robots recorded something. Must never make a day look empty that holds recordings.

import { focusOn, h, replace } from "./shared/dom.js";
import { get } from "./api.js";
import { dateOf, dayName, dayOf, redraw, sensorName, thingsOf, zone } from "./pieces.js";
import { locale, t } from "./texts.js";

const LATEST_COUNT = 7;
const BUSY_COUNTS = [1, 25, 250];
let month = null;
let chosen = { robot: "", sensor: "" };

/** Show the days, a month at a time, with what they hold. */
export async function showCalendar(context) {
  let data = await load(context.signal);
  const newest = data.days[0]?.day ?? dayOf(Date.now());
  month ??= newest.slice(0, 7);
  const node = h("div", {});
  const newestOfMonth = () => data.days.find((day) => day.day.startsWith(month))?.day ?? `${month}-01`;
  let focused = newestOfMonth();
  let hasMoved = false;

  const draw = () => replace(node,
    summary(context.overview, data),
    h("div", { class: "home" },
      h("section", { class: "card", "aria-label": t("calendar.label") }, filters(), monthBar(), grid(), legend()),
      h("div", {}, visits(), latest())));

  const latest = () => data.days.length > 0 && h("section", { class: "card" }, h("h2", {}, t("calendar.latest")), h("ul", { class: "latest" }, data.days.slice(0, LATEST_COUNT).map((day) =>
    h("li", {}, h("a", { href: `#/day/${day.day}`, "data-key": `latest-${day.day}` }, dayName(dateOf(day.day).getTime())), h("span", { class: "quiet" }, ` ${countOf(day)}`), day.corrupted > 0 && [" ", h("span", { class: "badge bad" }, t("verdict.corruptedCount", { count: day.corrupted }))]))));

  const filters = () => data.robots.length + data.sensors.length > 2 && h("div", { class: "row filters" },
    choice(t("calendar.robot"), "robot", [["", t("calendar.anyRobot")], ...data.robots.map((one) => [one.robot, one.called])]),
    choice(t("calendar.sensor"), "sensor", [["", t("calendar.anySensor")], ...data.sensors.map((code) => [code, sensorName(code)])]));

  const choice = (label, name, options) => {
    const select = h("select", { "data-key": `filter-${name}`, onchange: async (event) => {
      chosen = { ...chosen, [name]: event.target.value };
      data = await load(context.signal);
      redraw(node, draw);
    } }, options.map(([value, words]) => h("option", { value }, words)));
    select.value = chosen[name];
    return h("label", {}, label, " ", select);
  };

  const turn = (months, day) => {
    const [year, number] = month.split("-").map(Number);
    month = dayOf(new Date(year, number - 1 + months, 1)).slice(0, 7);
    focused = day ?? newestOfMonth();
    hasMoved = true;
  };

  const monthBar = () => h("div", { class: "row month" },
    h("button", { type: "button", "data-key": "back", "aria-label": t("calendar.previous"), onclick: () => redraw(node, () => { turn(-1); draw(); }) }, "‹"),
    h("h2", { "aria-live": "polite" }, capital(new Intl.DateTimeFormat(locale(), { month: "long", year: "numeric" }).format(dateOf(`${month}-01`)))),
    h("button", { type: "button", "data-key": "on", "aria-label": t("calendar.next"), onclick: () => redraw(node, () => { turn(1); draw(); }) }, "›"),
    h("button", { type: "button", class: "plain push", "data-key": "today", onclick: () => redraw(node, () => { month = dayOf(Date.now()).slice(0, 7); turn(0, dayOf(Date.now())); draw(); }) }, t("calendar.today")));

  const grid = () => {
    const known = new Map(data.days.map((day) => [day.day, day]));
    const first = dateOf(`${month}-01`);
    const start = new Date(first.getFullYear(), first.getMonth(), 1 - ((first.getDay() + 6) % 7));
    const weeks = [];
    for (let week = 0; week < 6; week += 1) {
      const days = [0, 1, 2, 3, 4, 5, 6].map((number) => new Date(start.getFullYear(), start.getMonth(), start.getDate() + week * 7 + number));
      if (week > 0 && days[0].getMonth() !== first.getMonth()) break;
      weeks.push(days);
    }
    const weekday = (style) => weeks[0].map((date) => new Intl.DateTimeFormat(locale(), { weekday: style }).format(date));
    const long = weekday("long");
    return h("table", { class: "calendar", role: "grid", "aria-label": t("calendar.label"), onkeydown: move },
      h("thead", {}, h("tr", {}, weekday("short").map((name, place) => h("th", { scope: "col", abbr: long[place] }, name.slice(0, 3))))),
      h("tbody", {}, weeks.map((days) => h("tr", {}, days.map((date) => cell(date, known.get(dayOf(date.getTime()))))))));
  };

  const cell = (date, day) => {
    const name = dayOf(date.getTime());
    const outside = !name.startsWith(month);
    const today = name === dayOf(Date.now());
    const tone = day?.corrupted > 0 ? " bad" : "";
    const heat = day ? ` has${day.records ? "" : " notes"} busy-${BUSY_COUNTS.filter((least) => day.records >= least).length}` : "";
    const words = [dayName(date.getTime()), today && t("calendar.isToday"), day ? countOf(day) : t("calendar.nothing"), day?.corrupted > 0 && t("calendar.corrupted", { count: day.corrupted })].filter(Boolean).join(", ");
    return h("td", { role: "gridcell", class: outside ? "outside" : "" },
      h("button", { type: "button", class: `day${heat}${tone}`, tabindex: name === focused ? 0 : -1, "data-key": name, "data-day": name, "aria-label": words, "aria-current": today ? "date" : undefined, "aria-disabled": day ? undefined : "true",
        onclick: () => (day ? context.go(`day/${name}`) : undefined) },
      h("span", { class: "number" }, String(date.getDate())), h("span", { class: "count" }, day ? new Intl.NumberFormat(locale(), { notation: "compact" }).format(day.records || day.notices) : "")));
  };

  const move = (event) => {
    const from = event.target.closest("[data-day]");
    const date = from && dateOf(from.dataset.day);
    if (!date) return;
    const steps = { ArrowLeft: -1, ArrowRight: 1, ArrowUp: -7, ArrowDown: 7, Home: -((date.getDay() + 6) % 7), End: 6 - ((date.getDay() + 6) % 7) };
    let to;
    if (event.key in steps) to = new Date(date.getFullYear(), date.getMonth(), date.getDate() + steps[event.key]);
    else if (event.key === "PageUp" || event.key === "PageDown") to = new Date(date.getFullYear(), date.getMonth() + (event.key === "PageUp" ? -1 : 1), Math.min(date.getDate(), 28));
    else return;
    event.preventDefault();
    focused = dayOf(to.getTime());
    hasMoved = true;
    month = focused.slice(0, 7);
    draw();
    focusOn(node.querySelector(`[data-day="${focused}"]`));
  };

  const visits = () => {
    const open = data.visits.filter((visit) => visit.rights_lines.length || visit.missing_records || visit.unreadable_records || visit.needs_former_words);
    return open.length > 0 && h("section", { class: "card" }, h("h2", {}, t("calendar.rights")), open.map((visit) => h("div", { class: "visit-note" },
      h("p", {}, h("a", { href: `#/visit/${visit.visit}` }, t("visit.of", { day: dayName(visit.first_ms) }))),
      h("ul", { class: "sentences" }, visit.rights_lines.map((line) => h("li", {}, line)),
        visit.missing_records > 0 && h("li", { class: "bad-words" }, t("visit.missing", { count: visit.missing_records })),
        visit.unreadable_records > 0 && h("li", { class: "bad-words" }, t("visit.unreadable", { count: visit.unreadable_records })),
        visit.needs_former_words && h("li", {}, t("visit.former"))))));
  };

  draw();
  return { title: t("calendar.title"), node, async refresh() {
    data = await load(context.signal);
    if (!hasMoved) focused = newestOfMonth();
    redraw(node, draw);
  } };
}

/** How many recordings a day has; a day of notes alone has none, and is not empty. */
const countOf = (day) => (day.records > 0 ? t("calendar.count", { count: day.records }) : t("calendar.notices", { count: day.notices }));
const capital = (words) => words.charAt(0).toLocaleUpperCase(locale()) + words.slice(1);

function load(signal) {
  return get("days", { ...chosen, zone: zone() }, signal);
}

function summary(overview, data) {
  const isChosen = Boolean(chosen.robot || chosen.sensor);
  if (data.days.length === 0 && !isChosen && overview.state !== "reading") return h("div", { class: "card" }, h("p", {}, h("strong", {}, t("calendar.empty"))), h("p", { class: "quiet" }, t("calendar.emptyNext")));
  const { counts } = overview;
  return h("div", { class: "lead" },
    h("p", {}, t("calendar.summary", { count: counts.records }), " ", Object.keys(counts.kinds).length > 0 && t("calendar.pictures", { count: counts.records, things: thingsOf(counts.kinds) }), " ", counts.withheld > 0 && t("calendar.withheld", { count: counts.withheld })),
    data.days.length === 0 && isChosen && h("div", { class: "notice", role: "status" }, h("p", {}, t("calendar.none"), " ", t("calendar.noneNext"))),
    overview.notice?.changed && h("div", { class: "notice warn" }, h("p", {}, t("notice.changed", { organisation: overview.notice.organisation }), " ", h("a", { href: "#/consent" }, t("notice.read")))));
}

function legend() {
  return h("ul", { class: "legend", "aria-hidden": "true" },
    h("li", {}, h("span", { class: "day-swatch busy-1" }), t("calendar.legendFew")), h("li", {}, h("span", { class: "day-swatch busy-3" }), t("calendar.legendMany")), h("li", {}, h("span", { class: "day-swatch now" }), t("calendar.legendToday")));
}
