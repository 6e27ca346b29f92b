// Draws the episodes in `replays` and lets the reader step through them. Plain SVG, no library.
const SVG = "http://www.w3.org/2000/svg";

function element(name, attributes, parent) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (parent) parent.append(made);
  return made;
}

const points = (path) => path.map(([x, y]) => `${x},${-y}`).join(" ");

function scene(data, holder) {
  // Metres, y upwards: all y are negated. Where nobody ever is, is cut off.
  const places = data.steps.flatMap((s) => s.state).concat(data.final, data.goals);
  const range = (axis) => {
    const values = places.map((place) => (axis ? -place[axis] : place[axis]));
    return [Math.min(...values), Math.max(...values)];
  };
  const [[x0, x1], [y0, y1]] = [range(0), range(1)];
  const largest = Math.max(...data.footprints.map(([length, width, radius]) => Math.max(length, width) + 2 * radius));
  const margin = 0.08 * Math.max(x1 - x0, y1 - y0) + largest;
  const width = Math.max(x1 - x0 + 2 * margin, 0.6 * (y1 - y0 + 2 * margin));
  const height = Math.max(y1 - y0 + 2 * margin, 0.4 * width);
  const [left, top] = [(x0 + x1 - width) / 2, (y0 + y1 - height) / 2];
  const svg = element("svg", {
    viewBox: `${left} ${top} ${width} ${height}`, role: "img", "aria-label": "the scene from above",
  }, holder);
  element("rect", { x: left, y: top, width, height, fill: "#f0eee9" }, svg);
  for (const shape of data.scenery.shapes) {
    if (shape.disc) element("circle", { cx: shape.disc[0], cy: -shape.disc[1], r: shape.disc[2], fill: shape.colour }, svg);
    else element("polygon", { points: points(shape.corners), fill: shape.colour }, svg);
  }
  return [element("g", {}, svg), width / 2];
}

function body(data, i, [x, y, heading], group, half) {
  const [length, width, radius] = data.footprints[i];
  const ring = i === data.ego ? "#282828" : "#ffffff";
  const edge = Math.min(half / 90, 0.06 * Math.max(width, 2 * radius));
  const shared = { fill: data.colours[i], stroke: ring, "stroke-width": edge };
  if (length > 0) {
    const turn = `translate(${x},${-y}) rotate(${(-heading * 180) / Math.PI})`;
    const box = element("g", { transform: turn }, group);
    element("rect", { x: -length / 2 - radius, y: -width / 2 - radius, width: length + 2 * radius,
                      height: width + 2 * radius, rx: radius, ...shared }, box);
    element("rect", { x: 0.15 * length, y: -0.36 * width, width: 0.14 * length, height: 0.72 * width, fill: "#ffffffa0" }, box);
  } else {
    element("circle", { cx: x, cy: -y, r: Math.max(radius, half / 45), ...shared }, group);
  }
}

function drawScene(data, k, group, half) {
  group.replaceChildren();
  const line = half / 110;
  const now = k < data.steps.length ? data.steps[k] : null;
  const state = now ? now.state : data.final;
  data.goals.forEach(([x, y], i) => {
    const s = half / 40;
    element("path", { d: `M${x - s},${-y - s}L${x + s},${-y + s}M${x - s},${-y + s}L${x + s},${-y - s}`,
                      stroke: data.colours[i], "stroke-width": 1.6 * line, fill: "none" }, group);
  });
  data.names.forEach((_, i) => {
    const trail = data.steps.slice(0, k).map((s) => s.state[i]).concat([state[i]]);
    element("polyline", { points: points(trail), fill: "none", stroke: data.colours[i],
                          "stroke-opacity": 0.4, "stroke-width": 2.2 * line }, group);
    for (const step of data.steps.slice(Math.max(0, k - 9), k + 1)) {
      const [x, y] = step.seen[i];
      if (x !== null) element("circle", { cx: x, cy: -y, r: 0.9 * line, fill: data.colours[i], "fill-opacity": 0.75 }, group);
    }
  });
  if (now) {
    for (const [j, path] of Object.entries(now.predicted)) {
      element("polyline", { points: points(path), fill: "none", stroke: data.colours[j],
                            "stroke-width": 1.5 * line, "stroke-dasharray": `${3 * line} ${2 * line}` }, group);
    }
    if (now.planned.length) {
      element("polyline", { points: points(now.planned), fill: "none", stroke: data.colours[data.ego],
                            "stroke-width": 1.5 * line }, group);
    }
  }
  state.forEach((place, i) => body(data, i, place, group, half));
}

function gammaOf(value) {
  // Who plays no game has none.
  return value === null ? "none" : value.toFixed(2);
}

function curves(data, holder) {
  // Discount factors over time: estimate (line), 90 % interval (band), truth (dashes).
  if (!data.infers) {
    const note = document.createElement("p");
    note.className = "dim";
    note.textContent = "This ego infers no discount factors. True ones: " +
      data.gamma.map((g, i) => `${data.names[i]} ${gammaOf(g)}`).join(", ") + ".";
    holder.append(note);
    return () => {};
  }
  const [w, h, left, low] = [420, 260, 44, 34];
  const end = Math.max(1, data.steps.length - 1);
  const x = (k) => left + ((w - left - 10) * k) / end;
  const y = (g) => 10 + (h - low - 10) * (1 - Math.min(Math.max(g, 0), 1));
  const svg = element("svg", { viewBox: `0 0 ${w} ${h}`, role: "img",
                               "aria-label": "inferred discount factors over time" }, holder);
  const text = (content, at, extra) =>
    (element("text", { ...at, "font-size": 12, fill: "#5a6370", ...extra }, svg).textContent = content);
  for (const g of [0, 0.5, 1]) {
    element("line", { x1: left, x2: w - 10, y1: y(g), y2: y(g), stroke: "#d5dae1" }, svg);
    text(g.toFixed(1), { x: left - 6, y: y(g) + 4 }, { "text-anchor": "end" });
  }
  text("discount factor", { x: 12, y: h / 2 }, { transform: `rotate(-90 12 ${h / 2})`, "text-anchor": "middle" });
  for (const k of [0, Math.round(end / 2), end]) {
    text(`${(k * data.dt).toFixed(1)} s`, { x: x(k), y: h - low + 18 }, { "text-anchor": k === end ? "end" : "middle" });
  }
  data.names.forEach((_, j) => {
    if (j === data.ego) return;
    if (data.gamma[j] !== null) {
      element("line", { x1: left, x2: w - 10, y1: y(data.gamma[j]), y2: y(data.gamma[j]),
                        stroke: data.colours[j], "stroke-dasharray": "6 4", "stroke-width": 1.5 }, svg);
    }
    const known = data.steps.map((s, k) => [k, s.gammas[j]]).filter(([, g]) => g);
    if (!known.length) return;
    const upper = known.map(([k, [m, d]]) => `${x(k)},${y(m + d)}`);
    const lower = known.map(([k, [m, d]]) => `${x(k)},${y(m - d)}`).reverse();
    element("polygon", { points: upper.concat(lower).join(" "), fill: data.colours[j], "fill-opacity": 0.2 }, svg);
    element("polyline", { points: known.map(([k, [m]]) => `${x(k)},${y(m)}`).join(" "), fill: "none",
                          stroke: data.colours[j], "stroke-width": 2 }, svg);
  });
  const cursor = element("line", { y1: 10, y2: h - low, stroke: "#1b1f24" }, svg);
  return (k) => {
    const at = x(Math.min(k, end));
    cursor.setAttribute("x1", at);
    cursor.setAttribute("x2", at);
  };
}

function legend(data, holder) {
  data.names.forEach((name, i) => {
    const entry = document.createElement("span");
    const dot = document.createElement("i");
    dot.style.background = data.colours[i];
    entry.append(dot, `${name}${i === data.ego ? " (ego)" : ""}, gamma ${gammaOf(data.gamma[i])}`);
    holder.append(entry);
  });
  const note = document.createElement("span");
  note.textContent = "thick: true path; dots: observations; dashes: predicted; thin: planned; cross: goal";
  note.style.whiteSpace = "normal";
  holder.append(note);
}

for (const holder of document.querySelectorAll("[data-replay]")) {
  const data = replays[Number(holder.dataset.replay)];
  const [group, half] = scene(data, holder.querySelector(".scene"));
  const mark = curves(data, holder.querySelector(".curves"));
  legend(data, holder.querySelector(".legend"));
  const slider = holder.querySelector("input");
  const output = holder.querySelector("output");
  slider.max = data.steps.length;
  let timer = null;

  function show(k) {
    slider.value = Math.min(Math.max(k, 0), data.steps.length);
    k = Number(slider.value);
    drawScene(data, k, group, half);
    mark(k);
    const now = data.steps[k];
    output.textContent = `${(k * data.dt).toFixed(1)} s` +
      (now ? (now.failed ? ", a solve failed: the last plan is continued" : "") : ", the end");
  }
  function stop() {
    clearInterval(timer);
    timer = null;
  }
  slider.addEventListener("input", () => { stop(); show(Number(slider.value)); });
  for (const button of holder.querySelectorAll("[data-step]")) {
    button.addEventListener("click", () => { stop(); show(Number(slider.value) + Number(button.dataset.step)); });
  }
  holder.querySelector("[data-play]").addEventListener("click", () => {
    if (timer) return stop();
    if (Number(slider.value) >= data.steps.length) show(0);
    timer = setInterval(() => {
      if (Number(slider.value) >= data.steps.length) return stop();
      show(Number(slider.value) + 1);
    }, 1000 * data.dt);
  });
  show(Math.round(data.steps.length / 3)); // in the middle of it, where a still picture tells most
}
