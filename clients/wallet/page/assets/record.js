// A recording, or a whole visit: player, seal, what happened to it, and what can be done with it.

import { announce, h, replace } from "./shared/dom.js";
import { follow, forget, get, post } from "./api.js";
import { clock, contentOf, dayName, dayOf, moment, problemCard, progressOf, reasonName, sensorName } from "./pieces.js";
import { makePlayer } from "./player.js";
import { makeSeal, titleOf, uncheckedSeal, unsealed } from "./seal.js";
import { choose, takeWish } from "./selection.js";
import { storyList } from "./story.js";
import { t } from "./texts.js";

const RECORDS_A_CLIP_COUNT = 80;
const ROWS_COUNT = 2_000;

/** Show one recording. */
export async function showRecord(context, id) {
  const record = await get(`records/${id}`, {}, context.signal);
  const back = { href: `#/day/${dayOf(record.started_at_ms)}`, label: dayName(record.started_at_ms) };
  const title = t("record.title", { time: clock(record.started_at_ms) });
  const story = h("div", {}, storyList(record.events));
  const facts = h("div", {});
  const screen = makeScreen(context, [record], { title, back: `record/${id}` });
  const draw = (now) => {
    replace(facts, factsOf(now));
    replace(story, storyList(now.events));
  };
  draw(record);
  const node = h("div", { class: "record" },
    screen.node,
    h("nav", { class: "row neighbours", "aria-label": t("record.neighbours") },
      record.previous && h("a", { class: "button", href: `#/record/${record.previous}` }, `‹ ${t("record.previous")}`), record.next && h("a", { class: "button", href: `#/record/${record.next}` }, `${t("record.next")} ›`),
      h("a", { href: `#/visit/${record.visit}/${dayOf(record.started_at_ms)}` }, t("record.visit"))),
    h("div", { class: "two" }, h("section", { class: "card" }, h("h2", {}, t("record.story")), story), h("section", { class: "card" }, h("h2", {}, t("record.facts")), facts)));
  return { title, back, node, keep: screen.keep, onShown: () => screen.show(), shows: (one) => one === id, async refresh() {
    const now = await get(`records/${id}`, {}, context.signal);
    draw(now);
    screen.update([now]);
  } };
}

/** Show a whole visit, played part by part. */
export async function showVisit(context, visit, day) {
  const isWished = takeWish(visit);
  let rows = await rowsOf(visit, context.signal);
  if (rows.length === 0) return { title: t("visit.title"), back: { href: "#/", label: t("calendar.title") }, node: h("div", { class: "card" }, h("p", {}, t("visit.empty"))) };
  const from = rows[0].started_at_ms;
  const title = t("visit.of", { day: dayName(from) });
  const back = { href: `#/day/${day ?? dayOf(from)}`, label: dayName(from) };
  const screen = makeScreen(context, rows, { title, back: `visit/${visit}`, meeting: true });
  const story = await get("audit-events", { visit, limit: 100 }, context.signal);
  const list = h("div", {}, storyList(story.events));
  const node = h("div", { class: "record" }, h("p", {}, `${t("calendar.robot")} ${rows[0].robot_called} · `, t("visit.span", { from: clock(from), to: clock(rows.at(-1).ended_at_ms), count: rows.filter((row) => row.kind !== "notice").length })), screen.node, h("section", { class: "card" }, h("h2", {}, t("record.story")), list));
  return { title, back, node, keep: screen.keep, onShown: () => screen.show(isWished), shows: (id) => rows.some((row) => row.record_id === id), async refresh() {
    replace(list, storyList((await get("audit-events", { visit, limit: 100 }, context.signal)).events));
    rows = await rowsOf(visit, context.signal);
    screen.update(rows);
  } };
}

async function rowsOf(visit, signal) {
  const rows = [];
  let cursor;
  do {
    const page = await get("records", { visit, limit: ROWS_COUNT, cursor }, signal);
    rows.push(...page.records);
    cursor = page.next;
  } while (cursor);
  return rows;
}

/** The upper part: seal and player, opened on a wish, part by part; and the buttons of what can be done. */
function makeScreen(context, given, { title, back, meeting = false }) {
  let rows = given;
  let { part, look, clip: clipId, opened, opening, judging } = context.kept ?? { part: 0, look: crypto.randomUUID(), clip: null, opened: new Map(), opening: null, judging: null };
  let isKept = false;
  let player = null;
  let isUnchecked = false;
  const area = h("div", {});
  const seal = h("div", {});
  const buttons = h("div", { class: "row actions-inline" });
  const node = h("div", { class: "screen" }, seal, area, buttons);
  // `opened`: how many records were opened together, by the first of them: large ones are fewer. `look`: all parts are one request.
  const parts = () => {
    const usable = rows.filter((row) => row.status === "active" && !row.denied);
    const found = [];
    for (let from = 0; from < usable.length; from += found.at(-1).length) found.push(usable.slice(from, from + (opened.get(usable[from].record_id) ?? RECORDS_A_CLIP_COUNT)));
    return found;
  };
  context.onLeave(() => { if (clipId && !isKept) forget(`clips/${clipId}`); });

  const invite = () => {
    isUnchecked = false;
    const usable = parts();
    if (usable.length === 0) {
      replace(seal);
      replace(area, h("div", { class: "card" }, h("p", {}, goneWords(rows))));
      return;
    }
    replace(seal, rows.length === 1 ? unsealed(rows[0]) : null);
    replace(area, h("div", { class: "card invite" }, h("p", {}, rows.length === 1 ? contentOf(rows[0]) : t("visit.content", { count: rows.length })),
      h("p", {}, h("button", { type: "button", class: "primary big", "data-key": "watch", onclick: () => open() }, t("record.watch"))), h("p", { class: "quiet" }, t("record.watchNote"))));
  };

  const open = async (running) => {
    const wanted = parts()[part];
    const progress = progressOf(t("record.opening"));
    player?.stop();
    isUnchecked = false;
    replace(area, progress.node);
    try {
      opening = running ?? (await post("clips", { records: wanted.map((row) => row.record_id), look, meeting }, context.signal)).job;
      const result = await follow(opening, progress.show, context.signal);
      opening = null;
      if (clipId) forget(`clips/${clipId}`);
      clipId = result.clip;
      opened.set(wanted[0].record_id, result.records);
      const clip = await get(`clips/${clipId}`, {}, context.signal);
      showOpened(clip, { isPlaying: clip.seals.every((one) => one.state === "good") });
    } catch (error) {
      if (error.name === "AbortError") return;
      opening = null;
      if (error.code === "CANCELLED") {
        replace(area, problemCard(error, () => open()));
        return;
      }
      isUnchecked = true;
      replace(seal, uncheckedSeal(error, rows.length === 1 ? rows[0] : null));
      replace(area, h("div", { class: "notice bad" }, h("p", {}, t("seal.uncheckedText")), h("p", {}, h("button", { type: "button", "data-key": "again", onclick: () => open() }, t("problem.again")))));
    }
  };

  const judge = async (running) => {
    const progress = progressOf(t("record.checking"));
    const before = [...seal.childNodes];
    replace(seal, progress.node);
    try {
      judging = running ?? (await post(`clips/${clipId}/verdict`, {}, context.signal)).job;
      const { seals } = await follow(judging, progress.show, context.signal);
      judging = null;
      replace(seal, makeSeal(seals, () => judge()));
    } catch (error) {
      if (error.name === "AbortError") return;
      judging = null;
      replace(seal, problemCard(error, () => judge()), before);
    }
  };

  const showOpened = (clip, { isPlaying, at, hasFocus = true }) => {
    replace(seal, makeSeal(clip.seals, () => judge()));
    if (hasFocus) announce(titleOf(clip.seals));
    player = makePlayer(clip, context.overview.depth_scale, { at, signal: context.signal, onErase: (frame) => send("erase", { records: [frame.record_id], frames: [frame.index], title: t("erase.picture", { time: frame.captured_at_ms ? clock(frame.captured_at_ms) : String(frame.index + 1) }) })() });
    const count = parts().length;
    const turn = (by) => () => { part += by; open(); };
    const roomless = clip.missing_rooms.length > 0 && h("div", { class: "notice warn" }, h("p", {}, t("record.noRoom"), " ", clip.missing_rooms.map((one) => one.sentence).join(" ")));
    replace(area, player.node, roomless, count > 1 && h("nav", { class: "row", "aria-label": t("visit.parts") }, h("span", {}, t("visit.part", { number: part + 1, count })),
      part > 0 && h("button", { type: "button", onclick: turn(-1) }, t("visit.partBefore")), part < count - 1 && h("button", { type: "button", onclick: turn(1) }, t("visit.partNext"))));
    if (hasFocus) player.focus();
    if (isPlaying && !matchMedia("(prefers-reduced-motion: reduce)").matches) player.start();
  };

  const send = (place, selection) => () => {
    choose({ title, back, records: rows.filter((row) => row.status === "active").map((row) => row.record_id), ...selection });
    context.go(place);
  };

  const drawButtons = () => replace(buttons, rows.some((row) => row.status === "active") && [
    h("button", { type: "button", "data-key": "share", onclick: send("share") }, t("action.share")), h("button", { type: "button", "data-key": "export", onclick: send("export") }, t("action.export")), h("button", { type: "button", class: "danger", "data-key": "erase", onclick: send("erase") }, t("action.erase"))]);

  invite();
  drawButtons();
  /** Once it stands: what was open goes on in another language, without another request; else play, if they wished it. */
  const show = async (isWished) => {
    if (parts().length === 0) return;
    if (opening || isWished) {
      open(opening);
      return;
    }
    if (!clipId) return;
    const { place: at, isPlaying } = context.kept;
    try {
      showOpened(await get(`clips/${clipId}`, {}, context.signal), { isPlaying, at, hasFocus: false });
      if (judging) judge(judging);
    } catch (error) {
      if (error.name !== "AbortError") clipId = null;
    }
  };

  return { node, show, keep() {
    isKept = true;
    return { part, look, clip: clipId, opened, opening, judging, place: player?.place(), isPlaying: player?.isPlaying() };
  }, update(now) {
    const before = parts().flat().length;
    rows = now;
    if (clipId === null && (parts().flat().length !== before || (rows.length === 1 && !isUnchecked)) && !area.contains(document.activeElement) && !area.querySelector("[role=status]")) invite();
    if (!buttons.contains(document.activeElement)) drawButtons();
  } };
}

function goneWords(rows) {
  if (rows.some((row) => row.denied)) return t("record.denied");
  return t(rows.some((row) => row.status === "erasing") ? "record.erasing" : "record.erased");
}

function factsOf(record) {
  const withheld = record.withheld_reasons ?? [];
  return [h("dl", { class: "facts" },
    h("dt", {}, t("record.when")), h("dd", {}, moment(record.started_at_ms)), h("dt", {}, t("calendar.robot")), h("dd", {}, record.robot_called), h("dt", {}, t("record.what")), h("dd", {}, contentOf(record), record.kind === "notice" ? "" : ` · ${sensorName(record.sensor)}`),
    h("dt", {}, t("record.until")), h("dd", {}, moment(record.expires_at_ms)), h("dt", {}, t("record.number")), h("dd", { class: "mono" }, record.record_id), h("dt", {}, t("seal.recordedAt")), h("dd", {}, t("seal.block", { height: record.height }))),
  withheld.length > 0 && [h("h3", {}, t("record.withheld")), h("ul", { class: "sentences" }, withheld.map((one) => h("li", {}, t("record.withheldLine", { count: one.count, reason: reasonName(one.reason, one.sentence) }))))],
  record.rights_lines.length > 0 && [h("h3", {}, t("record.rights")), h("ul", { class: "sentences" }, record.rights_lines.map((line) => h("li", {}, line)))],
  record.shares.length > 0 && [h("h3", {}, t("record.shares")), h("ul", { class: "sentences" }, record.shares.map((one) => h("li", {}, t(`share.line.${one.status}`, { who: one.who, until: moment(one.until_ms) }))))]];
}
