// Draws an episode on a canvas and computes its readings.
"use strict";

const BITS = { crashed: 1, brakes: 2, left: 4, right: 8 };
const EGO_AT = 0.38; // fraction of the canvas's width
const SHOULDER_M = 1, DASH_M = 6, DASH_EVERY_M = 18, MARK_EVERY_M = 20;
const GHOST_ALPHA = 0.4, GHOST_FROM_M = 0.5;
const SCALE_PX = 24; // under the road
const LEAST_SCALE = 3.5; // px per metre

// The functions that read a packed future: a value at a frame, and a value between two frames.
async function readersOf(packed) {
  const bytes = Uint8Array.from(atob(packed.data), (character) => character.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const numbers = new Int32Array(await new Response(stream).arrayBuffer());
  const columns = {};
  let start = 0;
  for (const [name, unit, width] of packed.columns) {
    const values = numbers.subarray(start, start + packed.frames * width);
    for (let i = width; i < values.length; i++) values[i] += values[i - width];
    columns[name] = { values, unit, width };
    start += values.length;
  }
  const read = (name, frame, vehicle = 0) => {
    const { values, unit, width } = columns[name];
    return values[Math.min(frame, packed.frames - 1) * width + vehicle] * unit;
  };
  const between = (name, moment, vehicle) => {
    const frame = Math.min(Math.floor(moment), packed.frames - 1); // the shorter future stands still
    const next = Math.min(frame + 1, packed.frames - 1);
    const here = read(name, frame, vehicle);
    return here + (read(name, next, vehicle) - here) * Math.min(1, moment - frame);
  };
  return { read, between };
}

async function unpack(packed) {
  const others = packed.agent.filter((_, vehicle) => vehicle !== packed.ego);
  // By name, so that a letter means the same agent beside another replay of the episode.
  const driven = [...new Set(others)].sort((a, b) => (packed.agents[a] < packed.agents[b] ? -1 : 1));
  const ghosts = packed.ghosts && { ...packed, ...packed.ghosts, ...(await readersOf(packed.ghosts)) };
  const last = Math.max(packed.frames, packed.ghosts ? packed.ghosts.frames : 0) - 1;
  return { ...packed, ...(await readersOf(packed)), last, driven, ghosts };
}

function letterOf(replay, agent) {
  return String.fromCharCode(65 + (replay.driven.indexOf(agent) % 26));
}

class Road {
  constructor(canvas) {
    this.canvas = canvas;
    this.pen = canvas.getContext("2d");
    this.readColours();
  }

  readColours() {
    const style = getComputedStyle(this.canvas);
    const colour = (name) => {
      this.canvas.style.color = `var(--${name})`; // only a style resolves light or dark
      return style.color;
    };
    this.colours = {
      asphalt: colour("asphalt"), paint: colour("paint"), marks: colour("pale"),
      ego: colour("ego"), rim: colour("rim"), onVehicle: colour("on-vehicle"),
      wreck: colour("wreck"), brake: colour("brake"), indicator: colour("indicator"),
      agents: [0, 1, 2, 3, 4, 5, 6, 7].map((k) => colour(`agent-${k}`)),
      font: style.fontFamily,
    };
  }

  // The road as far as `reach` metres ahead of the ego, unless that makes vehicles too small.
  draw(replay, moment, reach) {
    const { canvas, pen } = this;
    const width = canvas.clientWidth;
    const wanted = Math.max(reach / (1 - EGO_AT), Math.min(110, Math.max(46, width / 8)));
    this.scale = Math.max(LEAST_SCALE, width / wanted); // px per metre
    const roadPx = (replay.lanes * replay.lane_m + 2 * SHOULDER_M) * this.scale;
    const height = Math.round(roadPx + SCALE_PX);
    const ratio = window.devicePixelRatio || 1;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
      canvas.style.height = `${height}px`;
    }
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    const followed = replay.ghosts && moment > replay.frames - 1 ? replay.ghosts : replay;
    this.from = followed.between("x", moment, replay.ego) - (EGO_AT * width) / this.scale;
    this.top = -replay.lane_m / 2 - SHOULDER_M;
    this.drawRoad(replay, width, roadPx);
    this.drawGhosts(replay, moment, width);
    for (let vehicle = 0; vehicle < replay.vehicles; vehicle++) {
      if (vehicle !== replay.ego) this.drawVehicle(replay, moment, vehicle, width);
    }
    this.drawVehicle(replay, moment, replay.ego, width);
  }

  // The vehicles of the other future, where they are somewhere else.
  drawGhosts(replay, moment, width) {
    const ghosts = replay.ghosts;
    if (!ghosts) return;
    this.pen.globalAlpha = GHOST_ALPHA;
    for (let vehicle = 0; vehicle < replay.vehicles; vehicle++) {
      const apart = ["x", "y"].map((name) =>
        ghosts.between(name, moment, vehicle) - replay.between(name, moment, vehicle));
      if (Math.hypot(...apart) < GHOST_FROM_M) continue;
      this.drawVehicle({ ...ghosts, driven: replay.driven }, moment, vehicle, width);
    }
    this.pen.globalAlpha = 1;
  }

  at(x, y) {
    return [(x - this.from) * this.scale, (y - this.top) * this.scale];
  }

  drawRoad(replay, width, roadPx) {
    const { pen, colours, scale } = this;
    pen.fillStyle = colours.asphalt;
    pen.fillRect(0, 0, width, roadPx);
    pen.strokeStyle = colours.paint;
    pen.lineWidth = 2;
    for (let border = 0; border <= replay.lanes; border++) {
      const [, y] = this.at(0, (border - 0.5) * replay.lane_m);
      const solid = border === 0 || border === replay.lanes;
      pen.setLineDash(solid ? [] : [DASH_M * scale, (DASH_EVERY_M - DASH_M) * scale]);
      pen.lineDashOffset = this.from * scale;
      pen.beginPath();
      pen.moveTo(0, y);
      pen.lineTo(width, y);
      pen.stroke();
    }
    pen.setLineDash([]);
    pen.fillStyle = colours.marks;
    pen.font = `11px ${colours.font}`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    const first = Math.ceil(this.from / MARK_EVERY_M) * MARK_EVERY_M;
    for (let mark = first; mark < this.from + width / scale; mark += MARK_EVERY_M) {
      const [x] = this.at(mark, 0);
      pen.fillRect(x, roadPx, 1, 4);
      pen.fillText(`${mark.toLocaleString("en")} m`, x, roadPx + 14);
    }
  }

  drawVehicle(replay, moment, vehicle, width) {
    const { pen, colours, scale } = this;
    const [x, y] = this.at(
      replay.between("x", moment, vehicle), replay.between("y", moment, vehicle));
    if (x < -160 || x > width + 160) return;
    const flags = replay.read("flags", Math.floor(moment), vehicle);
    const isEgo = vehicle === replay.ego;
    const long = (replay.length_m[vehicle] / 2) * scale;
    const wide = (replay.width_m[vehicle] / 2) * scale;
    pen.save();
    pen.translate(x, y);
    pen.rotate(replay.between("heading", moment, vehicle));
    pen.beginPath();
    if (isEgo) {
      // An arrow, so that its shape shows it too.
      const corners = [[-long, -wide], [long * 0.62, -wide], [long, 0], [long * 0.62, wide], [-long, wide]];
      corners.forEach((corner, k) => (k ? pen.lineTo(...corner) : pen.moveTo(...corner)));
      pen.closePath();
    } else {
      pen.roundRect(-long, -wide, 2 * long, 2 * wide, [2, wide * 0.6, wide * 0.6, 2]);
    }
    const place = replay.driven.indexOf(replay.agent[vehicle]);
    pen.fillStyle = isEgo ? colours.ego : colours.agents[place % colours.agents.length];
    pen.fill();
    if (isEgo) {
      pen.lineWidth = 2;
      pen.strokeStyle = colours.rim;
      pen.stroke();
    }
    if (flags & BITS.brakes) {
      pen.fillStyle = colours.brake;
      for (const side of [-1, 0.4]) pen.fillRect(-long, side * wide, 0.2 * long, 0.6 * wide);
    }
    if (flags & (BITS.left | BITS.right)) {
      pen.fillStyle = colours.indicator;
      const edge = flags & BITS.left ? -wide * 1.45 : wide;
      for (const end of [-long, long * 0.5]) pen.fillRect(end, edge, 0.5 * long, 0.45 * wide);
    }
    if (flags & BITS.crashed) {
      pen.strokeStyle = colours.wreck;
      pen.lineWidth = 3;
      pen.beginPath();
      for (const side of [-1, 1]) {
        pen.moveTo(-1.1 * long, -1.3 * side * wide);
        pen.lineTo(1.1 * long, 1.3 * side * wide);
      }
      pen.stroke();
    }
    pen.restore();
    pen.fillStyle = colours.onVehicle;
    pen.font = `600 ${Math.max(9, Math.min(12, wide * 1.25))}px ${colours.font}`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.fillText(isEgo ? "EGO" : letterOf(replay, replay.agent[vehicle]) + vehicle, x, y + 0.5);
  }
}

function readingsOf(replay, frame) {
  const read = (name) => replay.read(name, frame);
  const known = (name, digits, unit) =>
    read(name) < 0 ? "–" : `${read(name).toFixed(digits)}${unit}`;
  const action = read("action"), aside = read("target") - read("lane");
  const crashed = replay.read("flags", frame, replay.ego) & BITS.crashed;
  const steered = aside ? `to the ${aside < 0 ? "left" : "right"}` : "keeps its lane";
  const acceleration = read("acceleration");
  return {
    "decision": crashed ? "crashed" : action >= 0 ? replay.actions[action] : steered,
    "reward": known("reward", 2, ""),
    "speed": `${read("speed").toFixed(1)} m/s`,
    "acceleration": `${acceleration <= -0.05 ? "−" : "+"}${Math.abs(acceleration).toFixed(1)} m/s²`,
    "gap ahead": known("ahead", 1, " m"),
    "gap behind": known("behind", 1, " m"),
    "TTC": known("ttc", 1, " s"),
  };
}
