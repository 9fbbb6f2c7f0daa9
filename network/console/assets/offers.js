// Which faults make sense for a node as it is now, and why the others do not. Pure. Never the last word: the server refuses by itself.

const AT_WORK = ["signing", "suspended"];

/**
 * Why a fault cannot be done to this node now, by the fault's name; those that can be done are left out. `moment` is the
 * newest one, `facts` what is known of the node; of a node that says nothing only little is ruled out.
 */
export function refusals(name, facts, moment) {
  const node = moment?.nodes.find((one) => one.name === name);
  if (facts && !facts.breakable) return allOf(`${name} takes no faults: its node.toml does not allow them.`);
  if (!node) return {};
  const isDown = node.state === "stopped";
  const isPaused = node.state === "paused";
  const isSilent = node.state === "no answer";
  const deaf = isDown ? `${name} is stopped and would not notice: restart it first.` : isPaused ? `${name} is paused and would not notice: resume it first.` : "";
  const nothing = `Nothing is wrong with ${name} that this would end.`;
  const waits = isPaused ? `${name} is paused: resume it first.` : "";
  const found = {
    kill: isDown && `${name} is stopped already.`,
    restart: AT_WORK.includes(node.state) && !node.behaviour && `${name} runs and takes part: a restart would mend nothing.`,
    pause: isDown ? `${name} is stopped: there is nothing to pause.` : isPaused && `${name} is paused already.`,
    resume: !isPaused && `${name} is not paused.`,
    skew: deaf,
    unskew: waits || (!isSilent && !node.clock_set_ms && nothing),
    fill: deaf,
    free: waits || (!isSilent && !node.disks && nothing),
    byzantine: waits,
    heal: !isSilent && !isPaused && !isTouched(node, moment) && nothing,
  };
  return Object.fromEntries(Object.entries(found).filter(([, reason]) => reason));
}

function allOf(reason) {
  return Object.fromEntries(["kill", "restart", "pause", "resume", "skew", "unskew", "fill", "free", "byzantine", "heal"].map((fault) => [fault, reason]));
}

/** Tell whether something is wrong on purpose with a node or with a link to or from it. */
function isTouched(node, moment) {
  return Boolean(node.faults?.length || node.behaviour || moment.links.some((link) => link.words && (link.from === node.name || link.to === node.name)));
}
