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
  let id = null, replay = null, moment = 0, playing = false, before = 0;

  function show() {
    const frame = Math.min(Math.floor(moment), replay.last);
    road.draw(replay, moment);
    const seconds = (frame / replay.hz).toFixed(1);
    const all = (replay.last / replay.hz).toFixed(1);
    scrub.value = frame;
    scrub.setAttribute("aria-valuetext", `${seconds} s of ${all} s`);
    part("clock").textContent = `${seconds} / ${all} s`;
    const readings = readingsOf(replay, frame);
    for (const [name, value] of Object.entries(readings)) {
      part("readings").querySelector(`[data-name="${name}"]`).textContent = value;
    }
    const place = left + (right - left) * Math.min(1, moment / Math.max(replay.frames - 1, 1));
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
    moment = Math.max(0, Math.min(replay.last, Math.round(frame)));
    show();
    tell();
  }

  function play() {
    if (moment >= replay.last) moment = 0;
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
    if (moment < replay.last) {
      show();
      requestAnimationFrame(advance);
    } else {
      seek(replay.last);
    }
  }

  function toggle() {
    if (playing) seek(moment);
    else play();
  }

  async function open(wanted, seconds) {
    pause();
    if (!unpacked.has(wanted)) unpacked.set(wanted, await unpack(packed[wanted]));
    [id, replay] = [wanted, unpacked.get(wanted)];
    for (const link of document.querySelectorAll("a.episode")) {
      if (link.dataset.replay !== id) link.removeAttribute("aria-current");
      else link.setAttribute("aria-current", "true");
    }
    for (const each of player.querySelectorAll(".timelines")) each.hidden = each.dataset.replay !== id;
    const link = document.querySelector("a.episode[aria-current]");
    part("player-title").textContent = link.querySelector(".who").textContent;
    part("player-what").textContent = link.querySelector(".what").textContent;
    showLegend();
    scrub.max = replay.last;
    player.hidden = false;
    moment = Math.max(0, Math.min(replay.last, Math.round(seconds * replay.hz)));
    show();
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
      End: () => seek(replay.last),
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
      const share = ((pointer.clientX - box.left) / box.width - left) / (right - left);
      seek(share * (replay.frames - 1));
    };
    to(event);
    drawn.setPointerCapture(event.pointerId);
    drawn.onpointermove = to;
    drawn.onpointerup = drawn.onpointercancel = () => (drawn.onpointermove = null);
  });
  document.addEventListener("themechange", () => {
    road.readColours();
    if (replay) show();
  });
  new ResizeObserver(() => replay && show()).observe(part("road"));
  window.addEventListener("hashchange", follow);
  follow().then((found) => found || open(document.querySelector("a.episode").dataset.replay, 0));
})();
