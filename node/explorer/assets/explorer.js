// The explorer: gets in, follows the chain, shows the page that the address names. Never keeps a token but in memory.

import { announce, h, replace } from "./shared/dom.js";
import { formatClock } from "./shared/format.js";
import { api, entry, enter, followNeighbours } from "./api.js";
import { feed } from "./feed.js";
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
import { welcomePage } from "./page-welcome.js";

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

const LAST_MINUTE_MS = 60_000;
const main = document.getElementById("main");
const nav = document.getElementById("nav");
const state = document.getElementById("state");
let shown = new AbortController();

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

async function show(isFirst = false) {
  shown.abort();
  shown = new AbortController();
  const { signal } = shown;
  const [name, args] = place();
  const page = Object.hasOwn(PAGES, name) ? PAGES[name] : null;
  markNav(page?.under ?? name);
  main.setAttribute("aria-busy", "true");
  let content;
  try {
    if (!page) content = [h("h1", { tabindex: "-1" }, "There is no such page"), h("p", {}, go("live", "Go to the live page"))];
    else if (page.forMembers && entry.kind !== "member") content = welcomePage({ forMembers: true });
    else content = await page.render({ args, signal });
  } catch (problem) {
    if (problem.status === undefined) console.error(problem);
    content = [h("h1", { tabindex: "-1" }, "This cannot be shown"), problemView(problem)];
  }
  if (signal.aborted) return;
  replace(main, content);
  main.removeAttribute("aria-busy");
  const title = main.querySelector("h1");
  document.title = `${title?.textContent ?? ""} – ${feed.status?.node ?? "BlockRobot"} explorer`;
  if (!isFirst) {
    scrollTo(0, 0);
    title?.focus({ preventScroll: true });
    announce(title?.textContent ?? "");
    main.querySelector(".here")?.scrollIntoView({ block: "center" });
  }
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
  let words = entry.kind === "member" ? `session until ${formatClock(entry.endsMs)}` : "public explorer";
  let tone = "good";
  if (entry.kind === "member" && status && entry.endsMs - status.now_ms < LAST_MINUTE_MS) [words, tone] = ["the session ends within a minute", "warn"];
  if (feed.isOver) [words, tone] = ["session ended", "bad"];
  else if (problem?.code === "RATE_LIMITED") [words, tone] = ["the node is busy, trying again", "warn"];
  else if (problem) [words, tone] = ["not connected, trying again", "warn"];
  if (state.textContent !== words) {
    replace(state, h("span", { class: `badge ${tone}` }, words));
    if (tone !== "good") announce(words);
  }
  document.getElementById("ended").hidden = tone !== "bad";
  for (const name of document.querySelectorAll(".node-name")) name.textContent = status?.node ?? "this node";
}

document.querySelector(".skip-link").addEventListener("click", (event) => {
  event.preventDefault();
  main.focus();
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
  buildNav();
  feed.follow(showState);
  feed.status = status;
  await feed.catchUp().catch((problem) => { feed.problem = problem; });
  showState();
  addEventListener("hashchange", () => show());
  await show(true);
  followNeighbours(() => feed.isOver, () => {
    feed.run();
    show();
  });
  feed.run();
}

const status = await enter();
if (status === null) {
  replace(main, welcomePage({ reason: entry.reason }));
  main.removeAttribute("aria-busy");
  followNeighbours(() => feed.status === null, async () => begin(await api.status()));
} else {
  await begin(status);
}
