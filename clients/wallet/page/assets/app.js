// The wallet's page: opens the session, shows one view at a time, and listens for what is new.
// Must never keep anything once the session is over: no store, no cookie, no cache.

import { announce, focusOn, h, replace } from "./shared/dom.js";
import { onAnswer, openSession, Problem } from "./shared/fetching.js";
import { get, onClosed, post } from "./api.js";
import { showCalendar } from "./calendar.js";
import { moment, problemCard, zone } from "./pieces.js";
import { language, languages, loadTexts, t } from "./texts.js";

// Each view is fetched when it is first shown: the calendar stands at once.
const VIEWS = {
  "": async () => showCalendar, day: async () => (await import("./day.js")).showDay,
  record: async () => (await import("./record.js")).showRecord, visit: async () => (await import("./record.js")).showVisit,
  story: async () => (await import("./story.js")).showStory, consent: async () => (await import("./consent.js")).showConsent,
  sharing: async () => (await import("./sharing.js")).showSharing, share: async () => (await import("./sharing.js")).showShareForm,
  erasing: async () => (await import("./erasing.js")).showErasing, erase: async () => (await import("./erasing.js")).showEraseForm,
  export: async () => (await import("./export.js")).showExport, inbox: async () => (await import("./inbox.js")).showInbox,
};
const NAVIGATION = [["", "nav.recordings"], ["story", "nav.story"], ["consent", "nav.consent"], ["sharing", "nav.sharing"], ["erasing", "nav.erasing"], ["export", "nav.export"], ["inbox", "nav.inbox"]];
const BELONGS_TO = { day: "", record: "", visit: "", share: "sharing", erase: "erasing" };
const LISTEN_MS = 20_000;
const LISTEN_AGAIN_MS = 3_000;

const main = document.getElementById("main");
const bar = document.getElementById("bar");
const footer = document.getElementById("footer");
const news = h("div", { class: "news", id: "news" });
let overview = null;
let verified = null;
let shown = null;
let shownAt = "";
let newest = null;
let missed = null;  // what was new while a view was on its way: that was perhaps read before it
let leaving = new AbortController();
let isClosed = false;

/** What every view is given. */
const context = {
  get overview() { return overview; },
  /** Have what all views know read again. */
  async renew() {
    overview = await get("overview");
    drawBar(place().name);
  },
  /** Have the view called otherwise, once it shows something else. */
  retitle(title) {
    const heading = main.querySelector("h1");
    replace(heading, title);
    document.title = `${title} · BlockRobot`;
    focusOn(heading);
  },
  /** What the view itself kept over a change of language, else null. */
  kept: null,
  get signal() { return leaving.signal; },
  go(place) { location.hash = `#/${place}`; },
  onLeave(act) { leaving.signal.addEventListener("abort", act, { once: true }); },
};

function place() {
  const [name = "", ...rest] = location.hash.replace(/^#\/?/, "").split("/").map(decodePart);
  return { name, rest };
}

function decodePart(text) {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}

function isDay(text = "") {
  const noon = new Date(`${text}T12:00:00Z`);
  return /^\d{4}-\d\d-\d\d$/.test(text) && !Number.isNaN(noon.getTime()) && noon.toISOString().startsWith(text);
}

/** Tell whether an address can name something: a view, and the day or the recording that it is about. */
function isPlace({ name, rest }) {
  if (name === "day") return isDay(rest[0]);
  if (name === "record" || name === "visit") return /^[0-9a-f]+$/.test(rest[0] ?? "");
  return Object.hasOwn(VIEWS, name);
}

function showNoPlace() {
  return { title: t("problem.noPlace"), node: h("div", { class: "card" }, h("p", {}, t("problem.noPlaceText")), h("p", {}, h("a", { href: "#/" }, t("problem.noPlaceNext")))) };
}

async function showPlace({ keepFocus = false, kept = null, keepTyped = false } = {}) {
  context.kept = kept;
  leaving.abort();
  leaving = new AbortController();
  const signal = leaving.signal;
  const { name, rest } = place();
  history.replaceState({ command: command() }, "");
  const isThere = isPlace({ name, rest });
  drawBar(name);
  main.setAttribute("aria-busy", "true");
  missed = null;
  let view;
  try {
    const show = isThere ? await VIEWS[name]() : showNoPlace;
    if (signal.aborted) return;
    view = overview.state === "not_registered" ? await showRegistering() : await show(context, ...rest);
  } catch (error) {
    if (error.name === "AbortError" || isClosed) return;
    if (!(error instanceof Problem)) await get("overview").catch(() => {});  // a part of the page that could not be had: is anybody there?
    if (isClosed) return;
    view = { title: t("problem.title"), node: problemCard(error, () => showPlace()) };
  }
  if (signal.aborted || isClosed) return;
  const typed = keepTyped && shownAt === location.hash ? readTyped() : [];  // not before: they go on typing until now
  shown = view;
  shownAt = location.hash;
  const heading = h("h1", { tabindex: -1 }, view.title);
  replace(main, warnings(), view.back && h("p", { class: "back" }, h("a", { href: view.back.href }, `← ${view.back.label}`)), heading, view.node);
  main.removeAttribute("aria-busy");
  document.title = `${view.title} · BlockRobot`;
  if (!keepFocus) {
    focusOn(heading, { stay: true });
    window.scrollTo(0, 0);
  }
  view.onShown?.();
  writeTyped(typed);
  if (missed) await takeMissed(missed);
  dropNewsShown();
}

async function takeMissed(change) {
  try {
    await shown.refresh?.(change);
  } catch (error) {
    if (error.name !== "AbortError" && !(error instanceof Problem)) throw error;  // they have gone on, or nobody is there
  }
}

async function showRegistering() {
  return (await import("./register.js")).showRegister(context);
}

function warnings() {
  const problem = overview.problem;
  return h("div", { id: "warnings" },
    overview.warnings.map((line) => h("div", { class: "notice bad", role: "alert" }, h("p", {}, line))),
    ["unreachable", "failed"].includes(overview.state) && h("div", { class: "notice warn", role: "status" },
      h("p", {}, h("strong", {}, t("network.away"))),
      h("p", {}, problem ? `${problem.detail} ${problem.next_step ?? ""}` : t("network.awayNext")),
      h("p", {}, h("button", { type: "button", onclick: () => post("refresh").catch(() => {}) }, t("network.again")))),
    overview.state === "reading" && h("div", { class: "notice", role: "status" }, h("p", {}, t("network.reading")), h("progress", { "aria-label": t("network.reading") })));
}

function drawBar(name) {
  const current = BELONGS_TO[name] ?? name;
  const chooser = h("select", { "aria-label": t("nav.language"), onchange: (event) => changeLanguage(event.target.value) },
    languages().map((code) => h("option", { value: code, lang: code }, t(`language.${code}`))));
  chooser.value = language();
  replace(document.getElementById("skip"), t("nav.skip"));
  replace(bar,
    h("a", { class: "brand", href: "#/" }, "BlockRobot ", h("span", { class: "quiet" }, overview.person.profile === "default" ? "" : overview.person.profile)),
    h("div", { class: "row tools" }, chooser, h("button", { type: "button", onclick: lock }, t("nav.lock"))),
    h("nav", { "aria-label": t("nav.label") }, NAVIGATION.map(([path, key]) =>
      h("a", { href: `#/${path}`, "aria-current": path === current ? "page" : undefined }, t(key),
        path === "inbox" && overview.counts.alarms > 0 && [" ", h("span", { class: "badge bad" }, String(overview.counts.alarms))]))));
  drawFooter();
}

function drawFooter() {
  const told = overview.state === "not_registered" ? ["lied", "unreachable"] : ["lied", "unreachable", "refused", "behind"];  // whom nobody knows yet, every node refuses
  const bad = overview.network.nodes.filter((node) => told.includes(node.state));
  replace(footer,
    h("p", {}, verified?.height ? t("footer.verified", { height: verified.height, time: moment(verified.time_ms) }) : t("footer.unverified")),
    bad.length > 0 && h("ul", { class: "sentences" }, bad.map((node) => h("li", { class: node.state === "lied" ? "bad-words" : "" }, t(`footer.${node.state}`, { name: node.name }), node.sentence ? ` ${node.sentence}` : ""))),
    h("p", {}, t("footer.zone", { zone: zone() })),
    h("p", {}, t("footer.local")));
}

/** Keep the foot no older than what an answer shows. */
function noteVerified(headers) {
  const [height, time] = (headers.get("X-BlockRobot-Verified") ?? "").split(" ").map(Number);
  if (!(height > (verified?.height ?? 0)) || isClosed) return;
  verified = { height, time_ms: time };
  if (overview !== null) drawFooter();
}

/** What opens this very wallet's page again, "" if that is not known; the browser's entry of the page remembers it. */
function command() {
  return overview?.person.command ?? history.state?.command ?? "";
}

function commandToType(typed) {
  return typed && h("pre", { tabindex: 0 }, h("code", {}, typed));
}

/** Say everything in another language. What is open stays open, and what was typed or picked stays: nothing is asked for again. */
async function changeLanguage(code) {
  await loadTexts(code);
  overview = await get("overview");
  const at = window.scrollY;
  await showPlace({ keepFocus: true, kept: shown?.keep?.() ?? null, keepTyped: true });
  focusOn(bar.querySelector("select"), { stay: true });
  window.scrollTo(0, at);
}

function readTyped() {
  return [...main.querySelectorAll("input[id]:not([type=password]), select[id], textarea[id]")].map(({ id, value }) => ({ id, value }));
}

function writeTyped(typed) {
  for (const { id, value } of typed) {
    const field = document.getElementById(id);
    if (!field || field.value === value) continue;
    field.value = value;
    field.dispatchEvent(new Event("change"));
  }
}

async function lock() {
  isClosed = true;
  leaving.abort();
  await post("end").catch(() => {});
  close(t("closed.locked"), t("closed.lockedNext"));
}

/** Clear everything from the screen: whoever comes next sees nothing. */
function close(title, text) {
  isClosed = true;
  leaving.abort();
  shown = null;
  document.querySelectorAll("dialog").forEach((dialog) => dialog.remove());
  replace(bar, h("span", { class: "brand" }, "BlockRobot"));
  replace(footer);
  replace(news);
  announce("");
  const heading = h("h1", { tabindex: -1 }, title);
  replace(main, heading, h("div", { class: "card" }, h("p", {}, text), commandToType(command())));
  main.removeAttribute("aria-busy");
  document.title = `${title} · BlockRobot`;
  focusOn(heading);
}

async function listen() {
  let heard = overview.news;
  let state = overview.state;
  while (!isClosed) {
    try {
      const change = await get("changes", { after: heard, wait_ms: LISTEN_MS });
      if (isClosed) return;
      if (change.news === heard && change.state === state) continue;
      heard = change.news;
      await takeNews(change, change.state !== state);
      state = change.state;
    } catch (error) {
      if (isClosed) return;
      await new Promise((done) => { setTimeout(done, LISTEN_AGAIN_MS); });
    }
  }
}

async function takeNews(change, isOther) {
  overview = await get("overview");
  if (change.new_records.length > 0) tellNew(change.new_records);
  const { name } = place();
  drawFooter();
  const isOut = overview.state === "not_registered" && !shown?.isRegistering;
  if (isOut || (isOther && !shown?.refresh)) {
    await showPlace({ keepFocus: true });
    return;
  }
  const old = document.getElementById("warnings");
  if (old) old.replaceWith(warnings());
  const count = overview.counts.alarms;
  const badge = bar.querySelector("nav .badge");
  if (String(count || "") !== (badge?.textContent ?? "") && !bar.contains(document.activeElement)) drawBar(name);
  if (main.hasAttribute("aria-busy")) missed = change;
  else if (!leaving.signal.aborted) await shown?.refresh?.(change);
  dropNewsShown();
}

/** Take away the line that tells of a recording which the view shows itself. */
function dropNewsShown() {
  if (newest === null || !shown?.shows?.(newest)) return;
  newest = null;
  replace(news);
}

function tellNew(ids) {
  const text = t("live.new", { count: ids.length });
  announce(text);
  newest = ids.at(-1);
  const note = h("div", { class: "notice accent row" }, h("span", {}, text), h("a", { href: `#/record/${ids.at(-1)}`, onclick: () => note.remove() }, t("live.show")),
    h("button", { type: "button", class: "plain push", onclick: () => note.remove() }, t("live.dismiss")));
  replace(news, note);
}

async function start() {
  main.before(news);
  onClosed((problem) => {
    if (!isClosed) close(t(problem.status === 401 ? "closed.session" : "closed.ended"), t(problem.status === 401 ? "closed.newLink" : "closed.next"));
  });
  document.getElementById("skip").addEventListener("click", (event) => {
    event.preventDefault();
    focusOn(main, { stay: true });
  });
  onAnswer(noteVerified);
  try {
    await openSession("./session");
    await loadTexts();
    overview = await get("overview");
  } catch (error) {
    if (isClosed) return;
    replace(main, h("h1", {}, "BlockRobot"), h("div", { class: "notice bad", role: "alert" }, h("p", {}, h("strong", {}, error.detail ?? String(error))), h("p", {}, error.nextStep ?? "")),
      commandToType(error.command ?? command()));
    return;
  }
  window.addEventListener("hashchange", () => { if (!isClosed) showPlace(); });
  await showPlace({ keepFocus: true });
  listen();
}

start();
