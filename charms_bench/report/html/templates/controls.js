// Plays, pauses and scrubs a replay, and opens one at a given time.
"use strict";

(() => {
  const store = document.getElementById("replay-data");
  if (!store) return;
  const packed = JSON.parse(store.textContent);
  const part = (id) => document.getElementById(id);
  const player = part("player"), scrub = part("scrub"), road = new Road(part("road"));
  const [left, right] = [Number(player.dataset.left), Number(player.dataset.right)]; // ends of the axes
  const unpacked = new Map(); // by id, once they are opened
  const roadBeside = new Road(part("road-beside"));
  let id = null, replay = null, beside = null, last = 0, moment = 0, playing = false, before = 0;

  function show() {
    const frame = Math.min(Math.floor(moment), last);
    const reach = Math.max(replay.reach_m, beside ? beside.reach_m : 0);
    road.draw(replay, moment, reach);
    if (beside) {
      const other = Math.min(Math.floor(moment), beside.last);
      roadBeside.draw(beside, Math.min(moment, beside.last), reach);
      const said = Object.entries(readingsOf(beside, other)).map(([name, value]) => `${name} ${value}`);
      part("beside-reading").textContent = said.join(" · ");
    }
    const seconds = (frame / replay.hz).toFixed(1);
    const all = (last / replay.hz).toFixed(1);
    scrub.value = frame;
    scrub.setAttribute("aria-valuetext", `${seconds} s of ${all} s`);
    part("clock").textContent = `${seconds} / ${all} s`;
    const readings = readingsOf(replay, frame);
    for (const [name, value] of Object.entries(readings)) {
      part("readings").querySelector(`[data-name="${name}"]`).textContent = value;
    }
    const place = left + (right - left) * Math.min(1, moment / Math.max(replay.last, 1));
    timelines().querySelector(".cursor").style.left = `${100 * place}%`;
    timelines().scrollLeft = place * timelines().scrollWidth - timelines().clientWidth / 2;
  }

  function timelines() {
    return player.querySelector(".timelines:not([hidden])");
  }

  function tell() {
    const frame = Math.floor(moment);
    const said = Object.entries(readingsOf(replay, frame)).map(([name, value]) => `${name} ${value}`);
    part("said").textContent = `${(frame / replay.hz).toFixed(1)} s: ${said.join(", ")}`;
    history.replaceState(null, "", hash());
  }

  function hash() {
    const seconds = (Math.floor(moment) / replay.hz).toFixed(2);
    return `#replay=${encodeURIComponent(id)}&t=${seconds}`;
  }

  function seek(frame) {
    pause();
    moment = Math.max(0, Math.min(last, Math.round(frame)));
    show();
    tell();
  }

  function play() {
    if (moment >= last) moment = 0;
    playing = true;
    before = performance.now();
    part("play").textContent = "Pause";
    requestAnimationFrame(advance);
  }

  function pause() {
    playing = false;
    part("play").textContent = "Play";
  }

  function advance(now) {
    if (!playing) return;
    moment += ((now - before) / 1000) * replay.hz * Number(part("rate").value);
    before = now;
    if (moment < last) {
      show();
      requestAnimationFrame(advance);
    } else {
      seek(last);
    }
  }

  function toggle() {
    if (playing) seek(moment);
    else play();
  }

  async function unpackedOf(wanted) {
    if (!unpacked.has(wanted)) unpacked.set(wanted, await unpack(packed[wanted]));
    return unpacked.get(wanted);
  }

  // The other agents in the same episode.
  function offerBeside() {
    const scene = JSON.stringify(packed[id].scene);
    const others = Object.keys(packed).filter(
      (each) => each !== id && scene && JSON.stringify(packed[each].scene) === scene);
    part("beside").replaceChildren(new Option("none", ""),
      ...others.map((each) => new Option(packed[each].title, each)));
    part("choose-beside").hidden = !others.length;
    return setBeside("");
  }

  async function setBeside(wanted) {
    beside = wanted ? await unpackedOf(wanted) : null;
    part("beside").value = wanted;
    part("beside-view").hidden = !beside;
    part("beside-title").textContent = beside ? packed[wanted].title : "";
    last = Math.max(replay.last, beside ? beside.last : 0);
    moment = Math.min(moment, last);
    scrub.max = last;
    show();
  }

  async function open(wanted, seconds) {
    pause();
    [id, replay, beside] = [wanted, await unpackedOf(wanted), null];
    for (const link of document.querySelectorAll("a.episode")) {
      if (link.dataset.replay !== id) link.removeAttribute("aria-current");
      else link.setAttribute("aria-current", "true");
    }
    for (const each of player.querySelectorAll(".timelines")) each.hidden = each.dataset.replay !== id;
    const link = document.querySelector("a.episode[aria-current]");
    part("player-title").textContent = link.querySelector(".who").textContent;
    part("player-what").textContent = link.querySelector(".what").textContent;
    showLegend();
    player.hidden = false;
    moment = Math.max(0, Math.min(replay.last, Math.round(seconds * replay.hz)));
    await offerBeside();
  }

  function showLegend() {
    const entry = (mark, name, colour, kind) => {
      const item = document.createElement("li"), swatch = document.createElement("span");
      swatch.className = `swatch ${kind}`;
      swatch.style.background = `var(--${colour})`;
      swatch.textContent = mark;
      item.append(swatch, ` ${name}`);
      return item;
    };
    part("legend").replaceChildren(
      entry("EGO", replay.agents[replay.agent[replay.ego]], "ego", "arrow"),
      ...replay.driven.map((agent, k) =>
        entry(letterOf(replay, agent), replay.agents[agent], `agent-${k % 8}`, "plain")));
  }

  async function follow() {
    const asked = new URLSearchParams(location.hash.slice(1));
    const wanted = asked.get("replay");
    if (wanted === null || !(wanted in packed)) return false;
    await open(wanted, Number(asked.get("t")) || 0);
    player.scrollIntoView({ block: "start" });
    return true;
  }

  for (const name of ["decision", "reward", "speed", "acceleration", "gap ahead", "gap behind", "TTC"]) {
    const pair = document.createElement("div");
    const term = document.createElement("dt"), value = document.createElement("dd");
    [term.textContent, value.dataset.name] = [name, name];
    pair.append(term, value);
    part("readings").append(pair);
  }

  // Shows the replays of one agent; the first of them opens if the open one is of another.
  function showOnly(ego) {
    const links = [...document.querySelectorAll("a.episode")];
    for (const each of links) each.parentElement.hidden = ego && each.parentElement.dataset.ego !== ego;
    const isShown = (each) => !each.parentElement.hidden;
    if (links.some((each) => isShown(each) && each.dataset.replay === id)) return;
    const first = links.find(isShown);
    open(first.dataset.replay, Number(first.dataset.start)).then(tell);
  }

  const only = part("only");
  if (only) {
    only.value = "";
    only.addEventListener("change", () => showOnly(only.value));
  }
  part("beside").addEventListener("change", () => {
    pause();
    setBeside(part("beside").value);
  });
  part("play").addEventListener("click", toggle);
  part("back").addEventListener("click", () => seek(Math.ceil(moment) - 1));
  part("forth").addEventListener("click", () => seek(Math.floor(moment) + 1));
  scrub.addEventListener("input", () => seek(Number(scrub.value)));
  part("link").addEventListener("click", async () => {
    history.replaceState(null, "", hash());
    try {
      await navigator.clipboard.writeText(location.href);
      part("link").textContent = "Copied";
    } catch {
      part("link").textContent = "The link is in the address bar";
    }
  });
  player.addEventListener("keydown", (event) => {
    const steers = event.target.matches("#scrub, #road, .timelines");
    const step = event.shiftKey ? replay.hz : 1;
    const keys = {
      " ": toggle,
      ArrowLeft: () => seek(Math.ceil(moment) - step),
      ArrowRight: () => seek(Math.floor(moment) + step),
      Home: () => seek(0),
      End: () => seek(last),
    };
    if (!steers || !(event.key in keys)) return;
    event.preventDefault();
    keys[event.key]();
  });
  player.addEventListener("pointerdown", (event) => {
    const drawn = event.target.closest(".timelines");
    if (!drawn) return;
    const to = (pointer) => {
      const box = drawn.firstElementChild.getBoundingClientRect();
      const fraction = ((pointer.clientX - box.left) / box.width - left) / (right - left);
      seek(fraction * replay.last);
    };
    to(event);
    drawn.setPointerCapture(event.pointerId);
    drawn.onpointermove = to;
    drawn.onpointerup = drawn.onpointercancel = () => (drawn.onpointermove = null);
  });
  document.addEventListener("themechange", () => {
    road.readColours();
    roadBeside.readColours();
    if (replay) show();
  });
  new ResizeObserver(() => replay && show()).observe(part("road"));
  window.addEventListener("hashchange", follow);
  const firstLink = document.querySelector("a.episode");
  follow().then((found) => found || open(firstLink.dataset.replay, Number(firstLink.dataset.start)));
})();
