// The explorer: gets in, follows the chain, shows the page that the address names.

import { announce, focusOn, h, replace } from "./shared/dom.js";
import { formatDuration, zoneName } from "./shared/format.js";
import { entry, enter, isOwn } from "./api.js";
import { RETRY_MAX_MS, feed, isAway } from "./feed.js";
import { go, problemView } from "./pieces.js";
import { blockPage } from "./page-block.js";
import { contractPage, contractsPage } from "./page-contracts.js";
import { custodyPage, erasurePage } from "./page-custody.js";
import { governancePage, proposalPage } from "./page-governance.js";
import { livePage } from "./page-live.js";
import { peoplePage } from "./page-people.js";
import { producersPage } from "./page-producers.js";
import { searchPage } from "./page-search.js";
import { transactionPage } from "./page-transaction.js";
import { awayPage, endedPage, welcomePage } from "./page-welcome.js";

const PAGES = {
  live: { name: "Live", render: livePage },
  producers: { name: "Producers", render: producersPage },
  contracts: { name: "Contracts", render: contractsPage, forMembers: true },
  members: { name: "Members", render: peoplePage, forMembers: true },
  custody: { name: "Custody", render: custodyPage, forMembers: true },
  governance: { name: "Governance", render: governancePage, forMembers: true },
  block: { render: blockPage, under: "live" },
  tx: { render: transactionPage, forMembers: true, under: "live" },
  contract: { render: contractPage, forMembers: true, under: "contracts" },
  erasure: { render: erasurePage, forMembers: true, under: "custody" },
  proposal: { render: proposalPage, forMembers: true, under: "governance" },
  search: { render: searchPage },
};

const AGAIN_MS = 1_000;
const main = document.getElementById("main");
const nav = document.getElementById("nav");
const state = document.getElementById("state");
let shown = new AbortController();
let failure = null; // why the page could not be shown; null if it could
let wasAway = false;
let announced = "";

/** Return the page that the address names, and its arguments. */
function place() {
  const [name, ...args] = location.hash.replace(/^#\/?/, "").split("/").filter(Boolean).map(decodePart);
  return [name ?? "live", args];
}

function decodePart(text) {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}

/** Show the page. `kind`: first, again (the same page, by itself) or moved (somebody went there). */
async function show(kind = "moved") {
  shown.abort();
  shown = new AbortController();
  const { signal } = shown;
  const [name, args] = place();
  const page = Object.hasOwn(PAGES, name) ? PAGES[name] : null;
  markNav(page?.under ?? name);
  main.setAttribute("aria-busy", "true");
  let content;
  let problem = null;
  try {
    if (!page) content = [h("h1", { tabindex: "-1" }, "There is no such page"), h("p", {}, go("live", "Go to the live page"))];
    else if (page.forMembers && entry.kind !== "member") content = welcomePage({ forMembers: true });
    else content = await page.render({ args, signal });
  } catch (thrown) {
    problem = thrown;
    content = failedPage(problem);
  }
  if (signal.aborted) return;
  failure = problem;
  const hadFocus = main.contains(document.activeElement);
  replace(main, content);
  main.removeAttribute("aria-busy");
  const title = main.querySelector("h1");
  document.title = `${title?.textContent ?? ""} – ${feed.status?.node ?? "BlockRobot"} explorer`;
  if (isAway(failure) && !feed.problem) setTimeout(() => { if (!signal.aborted) show("again"); }, AGAIN_MS);
  if (kind === "first") return;
  announce(title?.textContent ?? "");
  if (kind === "moved") scrollTo(0, 0);
  if (kind === "moved" || hadFocus) focusOn(title, { stay: true });
  if (kind === "moved") main.querySelector(".here")?.scrollIntoView({ block: "center" });
}

function failedPage(problem) {
  if (problem.status === 401 || (isAway(problem) && feed.isOver)) return endedPage(); // nothing asks again by itself
  if (isAway(problem)) return awayPage(feed.status?.node ?? "the node", RETRY_MAX_MS, isOwn && problem.status === 0);
  if (problem.status === undefined) console.error(problem);
  return [h("h1", { tabindex: "-1" }, "This cannot be shown"), problemView(problem)];
}

/** Show by itself what could not be shown while the node was away. */
function comeBack() {
  if (wasAway && !feed.isAway && isAway(failure)) show("again");
  wasAway = feed.isAway;
}

function markNav(current) {
  for (const link of nav.querySelectorAll("a")) {
    if (link.dataset.page === current) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
}

function buildNav() {
  replace(nav, Object.entries(PAGES).filter(([, page]) => page.name && (entry.kind === "member" || !page.forMembers))
    .map(([name, page]) => h("a", { href: `#/${name}`, "data-page": name }, page.name)));
}

/** Say how the page stands with the node: following, cut off, or out of session. */
function showState() {
  const { problem, status } = feed;
  let words = entry.kind === "member" ? "your session" : "public explorer";
  let tone = "good";
  if (feed.isOver) [words, tone] = ["session ended", "bad"];
  else if (problem?.code === "RATE_LIMITED") [words, tone] = [`the node is busy, asking again in ${formatDuration(feed.retryMs)}`, "warn"];
  else if (problem) [words, tone] = [`not connected, asking every ${RETRY_MAX_MS / 1000} s`, "warn"];
  if (state.textContent !== words) replace(state, h("span", { class: `badge ${tone}` }, words));
  const said = tone === "good" ? "" : words.split(",")[0];
  if (said !== announced) announce(said || "Connected again");
  announced = said;
  showEnd(tone === "bad");
  for (const name of document.querySelectorAll(".node-name")) name.textContent = status?.node ?? "this node";
}

/** Say why the session is over, and what to do. */
function showEnd(isOver) {
  const end = document.getElementById("ended");
  if (isOver && end.hidden) document.getElementById("ended-why").textContent = feed.problem.message;
  end.hidden = !isOver;
}

document.querySelector(".skip-link").addEventListener("click", (event) => {
  event.preventDefault();
  focusOn(main, { stay: true });
});

document.getElementById("search").addEventListener("submit", (event) => {
  event.preventDefault();
  const text = new FormData(event.target).get("what").trim();
  if (text) location.hash = `#/search/${encodeURIComponent(text)}`;
});

/** Show the chain from here on; `status` is the node's first word. */
async function begin(status) {
  document.body.classList.add("in");
  document.getElementById("tools").hidden = false;
  document.getElementById("word").hidden = false;
  document.getElementById("zone").textContent = `, ${zoneName()}`;
  buildNav();
  feed.follow(showState);
  feed.follow(comeBack);
  feed.status = status;
  await feed.catchUp().catch((problem) => { feed.problem = problem; });
  showState();
  addEventListener("hashchange", () => show());
  await show("first");
  addEventListener("online", () => feed.tryNow());
  document.addEventListener("visibilitychange", () => feed.tryNow());
  feed.run();
}

const status = await enter();
if (status === null) {
  replace(main, welcomePage({ reason: entry.reason }));
  main.removeAttribute("aria-busy");
} else {
  await begin(status);
}
