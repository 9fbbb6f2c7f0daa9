// What stands here for who has no session: how to get in. Must never ask for a key, a passphrase or a token.

import { h } from "./shared/dom.js";
import { card, problemView } from "./pieces.js";

const NO_NEWS = new Set(["SESSION_REQUIRED"]);

/** What stands here while the node gives no answer; the page is shown as soon as there is one. */
export function awayPage(name, everyMs, mayHaveEnded) {
  return [
    h("h1", { tabindex: "-1" }, "The node does not answer"),
    h("div", { class: "notice warn", role: "alert" },
      h("p", {}, `Nothing comes from ${name}: it is stopped, or cannot be reached from here.`),
      h("p", {}, `This page asks again every ${everyMs / 1000} seconds, and shows itself as soon as the node is back.`)),
    mayHaveEnded && h("p", {}, "This page comes from ", h("code", {}, "blockrobot explore"), ": if that has ended in its terminal, run it again."),
    h("p", {}, h("code", {}, "blockrobot status"), " on its machine says whether it runs."),
  ];
}

/** What stands here once the session is over; why, and what to do, stands above. */
export function endedPage() {
  return [h("h1", { tabindex: "-1" }, "This page needs a session"), h("p", {}, "Yours has ended: see above.")];
}

export function welcomePage({ reason = null, forMembers = false }) {
  const told = reason && !NO_NEWS.has(reason.code) ? problemView(reason) : null;
  return [
    h("h1", { tabindex: "-1" }, forMembers ? "This is for members" : "Look at the chain"),
    h("p", { class: "lead" }, forMembers
      ? "This node shows headers, producers and counts to anybody. What transactions say, who is a member, and what custodians reported, it shows to members of the network in their own sessions."
      : "This node serves an explorer of the network's chain. It shows what it knows to members of the network, each in a session of their own, and nothing to anybody else."),
    told,
    h("p", {}, "A page that was reloaded has lost its session: press Enter in the terminal where ", h("code", {}, "blockrobot explore"), " runs, or run it again."),
    card("How to get in",
      h("ol", {},
        h("li", {}, "Open a terminal on the machine that holds your key: your wallet, or the network's folder."),
        h("li", {}, "Run ", h("code", {}, "blockrobot explore"), ". With a wallet: ", h("code", {}, "blockrobot explore --profile NAME"), "."),
        h("li", {}, "Your browser opens a page of your own machine, in a session that lasts as long as the command runs.")),
      h("p", { class: "quiet" }, "The command signs a question of the node with your key, and asks it in your name. Key and session stay with the command; the browser gets a link to it that works once. This page never asks for a key, a passphrase or a token.")),
    card("For those who run the node",
      h("p", {}, "To show headers, producers and counts to anybody, write ", h("code", {}, "[explorer] public = true"), " into the node's ", h("code", {}, "node.toml"), " and start it again.")),
  ];
}
