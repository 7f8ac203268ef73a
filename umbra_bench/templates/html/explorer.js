"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const $ = (id) => document.getElementById(id);
  const methods = new Map(data.methods.map((m) => [m.name, m]));
  const scenarios = new Map(data.scenarios.map((s) => [s.name, s]));
  const state = { scenario: data.scenarios[0].name, precision: "float64", quantity: "position", step: "", hidden: new Set(), time: 0 };
  const unit = { position: "m", velocity: "m/s", energy: "energy scale" };
  const unpacked = new Map();
  let timer = 0;

  const floats = (text) => {
    if (!unpacked.has(text)) {
      const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
      unpacked.set(text, Array.from(new Float32Array(bytes.buffer)));
    }
    return unpacked.get(text);
  };
  const shown = (value) => value === null || value === undefined ? "–" : !Number.isFinite(value) ? "infinite"
    : value === 0 || (Math.abs(value) >= 0.01 && Math.abs(value) < 1e4) ? String(+value.toPrecision(3)) : value.toExponential(1);
  const element = (tag, text, attributes = {}) => {
    const made = document.createElement(tag);
    made.textContent = text;
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    return made;
  };

  // An engine has one precision of its own, and is drawn in it whichever is chosen.
  const linesOf = (scenario) => {
    const own = new Map();
    for (const line of scenario.lines) {
      const kept = own.get(line.method);
      if (!kept || line.precision === state.precision) own.set(line.method, line);
    }
    return [...own.values()];
  };

  const readAddress = () => {
    const asked = new URLSearchParams(location.hash.slice(1));
    if (!asked.has("scenario")) return false;
    if (scenarios.has(asked.get("scenario"))) state.scenario = asked.get("scenario");
    if (["float64", "float32"].includes(asked.get("precision"))) state.precision = asked.get("precision");
    if (asked.get("quantity") in unit) state.quantity = asked.get("quantity");
    state.step = asked.get("step") || "";
    state.hidden = new Set((asked.get("hide") || "").split(",").filter((name) => methods.has(name)));
    state.time = Math.max(0, Math.trunc(Number(asked.get("time"))) || 0);
    return true;
  };
  const writeAddress = () => {
    const told = new URLSearchParams({ scenario: state.scenario, precision: state.precision, quantity: state.quantity, step: state.step, hide: [...state.hidden].join(","), time: String(state.time) });
    history.replaceState(null, "", "#" + told);
  };

  const colours = () => {
    const style = getComputedStyle(document.documentElement);
    const dark = matchMedia("(prefers-color-scheme: dark)").matches;
    return { ink: style.getPropertyValue("--ink").trim(), line: style.getPropertyValue("--line").trim(), dark };
  };
  // On dark paper a dark colour is mixed with white until it stands out three to one, as WCAG asks of lines.
  const luminance = (rgb) => rgb.map((c) => (c / 255 <= 0.04045 ? c / 255 / 12.92 : ((c / 255 + 0.055) / 1.055) ** 2.4)).reduce((sum, c, i) => sum + c * [0.2126, 0.7152, 0.0722][i], 0);
  const inked = (colour) => {
    const { ink, dark } = colours();
    if (!dark) return colour;
    if (colour === "#000000") return ink;
    const rgb = [1, 3, 5].map((i) => parseInt(colour.slice(i, i + 2), 16));
    let mixed = rgb;
    for (let white = 0.1; luminance(mixed) < 0.14; white += 0.1) mixed = rgb.map((c) => Math.round(c + white * (255 - c)));
    return `rgb(${mixed.join(",")})`;
  };
  const layout = (x, y, more = {}) => {
    const { ink, line } = colours();
    const axis = { gridcolor: line, zerolinecolor: line, linecolor: ink, automargin: true };
    return { paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { color: ink, size: 12 }, margin: { l: 60, r: 10, t: 10, b: 45 },
      hovermode: "closest", showlegend: innerWidth > 640 || Boolean(more.key), modebar: { orientation: "v", bgcolor: "rgba(0,0,0,0)", color: line, activecolor: ink }, legend: innerWidth > 640 ? { font: { size: 10 }, x: 1.06 } : { font: { size: 10 }, orientation: "h", y: -0.25 }, xaxis: { ...axis, title: { text: x, standoff: 8 }, ...more.xaxis }, yaxis: { ...axis, title: { text: y, standoff: 12 }, ...more.yaxis }, shapes: more.shapes || [] };
  };
  const config = { displaylogo: false, responsive: true, modeBarButtonsToRemove: ["lasso2d", "select2d"] };
  const stroke = (method) => ({ color: inked(method.colour), dash: method.dash, width: 2 });
  const logarithmic = { type: "log", exponentformat: "power" };
  const trace = (line, more) => {
    const method = methods.get(line.method);
    return { name: method.title, meta: line.method, line: stroke(method), visible: state.hidden.has(line.method) ? "legendonly" : true, ...more };
  };

  const drawErrors = (scenario, lines) => {
    const traces = lines.map((line) => trace(line, { x: line.dt, y: line[state.quantity].map((v) => (v > 0 ? v : null)), mode: "lines+markers", marker: { size: 7, symbol: methods.get(line.method).symbol },
      hovertemplate: `%{fullData.name}<br>dt = %{x} s<br>%{y:.3g} ${unit[state.quantity]}<br>order ${line.orders[state.quantity]}<extra></extra>` }));
    const { ink } = colours();
    const shapes = [{ type: "line", x0: Number(state.step), x1: Number(state.step), y0: 0, y1: 1, yref: "paper", line: { color: ink, width: 1, dash: "dot" } }];
    const floor = scenario.floors[state.quantity];
    const least = Math.min(...traces.flatMap((t) => t.y.filter((v) => v !== null)));
    if (floor > least / 100) shapes.push({ type: "line", x0: 0, x1: 1, xref: "paper", y0: floor, y1: floor, line: { color: ink, width: 1, dash: "dash" }, label: { text: "floor of the reference", textposition: "start", font: { size: 10 } } });
    Plotly.react("error-plot", traces, layout("step dt (s)", `largest error of ${state.quantity} (${unit[state.quantity]})`, { xaxis: { ...logarithmic, dtick: 1 }, yaxis: logarithmic, shapes }), config);
  };
  const drawEnergy = (scenario, lines) => {
    const traces = lines.filter((line) => line.over_time).map((line) => trace(line, { x: floats(line.over_time.t), y: floats(line.over_time.error).map((v) => (v > 0 ? v : null)), mode: "lines",
      hovertemplate: "%{fullData.name}<br>t = %{x:.3g} s<br>largest |energy error| hereabouts = %{y:.3g}<extra></extra>" }));
    Plotly.react("energy-plot", traces, layout("time (s)", "|energy error| / energy scale", { yaxis: logarithmic }), config);
  };
  const pictures = { orbit: ["x", "y", "x (m)", "y (m)"], spring: ["x", "vx", "x (m)", "velocity in x (m/s)"], free_fall: ["t", "y", "time (s)", "height (m)"], rotation: ["t", "angle", "time (s)", "angle (rad)"] };
  const curve = (motion, key) => {
    const values = floats(motion[key]).slice();
    if (key === "angle") for (let i = 1; i < values.length; i++) values[i] -= 2 * Math.PI * Math.round((values[i] - values[i - 1]) / (2 * Math.PI));
    return values;
  };
  const nearest = (times, t) => {
    let best = 0;
    for (let i = 1; i < times.length; i++) if (Math.abs(times[i] - t) < Math.abs(times[best] - t)) best = i;
    return best;
  };
  const drawMotion = (scenario, lines) => {
    const [kx, ky, x, y] = pictures[scenario.family];
    const times = floats(scenario.reference.t);
    const now = times[Math.min(state.time, times.length - 1)];
    const rx = curve(scenario.reference, kx), ry = curve(scenario.reference, ky);
    const inside = (values, all) => { const reach = 3 * Math.max(...all.map(Math.abs), 1e-9); return values.map((v) => (Math.abs(v) < reach ? v : null)); };
    const { ink } = colours();
    const traces = [{ name: "Reference", meta: "", x: rx, y: ry, mode: "lines", line: { color: "#9aa4b1", width: 6 }, opacity: 0.6, hoverinfo: "skip" }];
    const dots = { x: [], y: [], colours: [], names: [] };
    const here = Math.min(state.time, times.length - 1);
    dots.x.push(rx[here]); dots.y.push(ry[here]); dots.colours.push("#9aa4b1"); dots.names.push("Reference");
    for (const line of lines) {
      if (!line.motion) continue;
      const mx = curve(line.motion, kx), my = curve(line.motion, ky);
      traces.push(trace(line, { x: inside(mx, rx), y: inside(my, ry), mode: "lines", hovertemplate: "%{fullData.name}<br>%{x:.3g}, %{y:.3g}<extra></extra>" }));
      if (state.hidden.has(line.method)) continue;
      const i = nearest(floats(line.motion.t), now);
      dots.x.push(mx[i]); dots.y.push(my[i]); dots.colours.push(stroke(methods.get(line.method)).color); dots.names.push(methods.get(line.method).title);
    }
    traces.push({ name: "now", meta: "", showlegend: false, x: dots.x, y: dots.y, text: dots.names, mode: "markers", marker: { color: dots.colours, size: 10, line: { color: ink, width: 1 } }, hovertemplate: "%{text}<br>%{x:.3g}, %{y:.3g}<extra></extra>" });
    const equal = scenario.family === "orbit" ? { yaxis: { scaleanchor: "x" } } : {};
    Plotly.react("motion-plot", traces, layout(x, y, equal), config);
    $("time").max = String(times.length - 1);
    $("time").value = String(here);
    $("clock").textContent = `${now.toPrecision(3)} s`;
  };
  const listValues = (scenario, lines) => {
    const table = $("values");
    table.replaceChildren();
    const head = table.createTHead().insertRow();
    for (const text of ["method", "state", `order of ${state.quantity}`, "position (m)", "velocity (m/s)", "energy"]) head.append(element("th", text, { scope: "col" }));
    const body = table.createTBody();
    for (const line of lines) {
      const i = line.dt.findIndex((dt) => dt === Number(state.step));
      if (i < 0 || state.hidden.has(line.method)) continue;
      const row = body.insertRow();
      row.append(element("th", methods.get(line.method).title, { scope: "row" }));
      const left = line.diverged[i] === null ? "" : `, diverged at ${shown(line.diverged[i])} s`;
      for (const text of [line.precision, line.orders[state.quantity], shown(line.position[i]), shown(line.velocity[i]), shown(line.energy[i]) + left]) row.append(element("td", text));
    }
  };

  const drawStability = () => {
    if (!document.getElementById("stability-plot") || !data.stability.length) return;
    const traces = data.stability.flatMap((line) => [
      { x: line.x, y: line.predicted, mode: "lines", line: { color: "#9aa4b1", width: 6 }, opacity: 0.5, showlegend: false, hoverinfo: "skip" },
      { name: line.title, x: line.x, y: line.measured, mode: "lines", line: stroke(line), hovertemplate: "%{fullData.name}<br>ω dt = %{x:.2f}<br>growth %{y:.4g}<extra></extra>" },
    ]);
    Plotly.react("stability-plot", traces, layout("ω dt", "growth per step", { key: true, yaxis: { range: [0.4, 3] } }), config);
  };
  const drawLongRuns = () => data.long_runs.forEach((lines, i) => {
    const traces = lines.map((line) => ({ name: line.title, x: line.steps, y: line.error.map((v) => (v > 0 && v < 1e6 ? v : null)), mode: "lines", line: stroke(line),
      hovertemplate: `%{fullData.name}<br>%{x:.3g} steps<br>largest error %{y:.3g}<br>${line.law}<extra></extra>` }));
    Plotly.react(`drift-plot-${i}`, traces, layout("steps", "|energy error| / energy scale", { key: true, xaxis: { ...logarithmic, dtick: 1 }, yaxis: { ...logarithmic, dtick: 2 } }), config);
  });
  const draw = () => {
    const scenario = scenarios.get(state.scenario);
    const lines = linesOf(scenario);
    const steps = [...new Set(lines.flatMap((line) => line.dt))].sort((a, b) => b - a);
    if (!steps.includes(Number(state.step))) state.step = String(scenario.step);
    $("scenario").value = state.scenario;
    $("precision").value = state.precision;
    $("quantity").value = state.quantity;
    $("step").replaceChildren(...steps.map((dt) => element("option", `${dt} s`, { value: String(dt) })));
    $("step").value = state.step;
    for (const box of document.querySelectorAll("#methods input")) box.checked = !state.hidden.has(box.value);
    $("description").textContent = `${scenario.title}: ${scenario.description}`;
    for (const swatch of document.querySelectorAll("#methods .swatch")) swatch.style.borderTopColor = inked(swatch.dataset.colour);
    listValues(scenario, lines);
    if (!window.Plotly) return;
    drawErrors(scenario, lines);
    drawEnergy(scenario, lines);
    drawMotion(scenario, lines);
    drawStability();
    drawLongRuns();
  };
  const change = (changes) => { Object.assign(state, changes); writeAddress(); draw(); };
  const toggle = (name) => {
    const hidden = new Set(state.hidden);
    if (!hidden.delete(name)) hidden.add(name);
    change({ hidden });
  };

  $("scenario").replaceChildren(...data.scenarios.map((s) => element("option", s.title, { value: s.name })));
  $("methods").replaceChildren(...data.methods.map((m) => {
    const label = document.createElement("label");
    const box = element("input", "", { type: "checkbox", value: m.name });
    box.addEventListener("change", () => toggle(m.name));
    const swatch = element("span", "", { class: "swatch", "aria-hidden": "true" });
    swatch.dataset.colour = m.colour;
    swatch.style.borderTopStyle = m.dash === "solid" ? "solid" : m.dash === "dash" ? "dashed" : "dotted";
    label.append(box, swatch, m.title);
    return label;
  }));
  $("scenario").addEventListener("change", (e) => change({ scenario: e.target.value, step: "", time: 0 }));
  $("precision").addEventListener("change", (e) => change({ precision: e.target.value }));
  $("quantity").addEventListener("change", (e) => change({ quantity: e.target.value }));
  $("step").addEventListener("change", (e) => change({ step: e.target.value }));
  $("time").addEventListener("input", (e) => change({ time: Number(e.target.value) }));
  $("controls").addEventListener("submit", (e) => e.preventDefault());
  const play = (on) => {
    clearInterval(timer);
    $("play").setAttribute("aria-pressed", String(on));
    $("play").textContent = on ? "Pause" : "Play";
    if (on) timer = setInterval(() => {
      const scenario = scenarios.get(state.scenario);
      if (!window.Plotly) return;
      state.time = (state.time + 1) % floats(scenario.reference.t).length;
      drawMotion(scenario, linesOf(scenario));
    }, 60);
    else writeAddress();
  };
  $("play").addEventListener("click", () => play($("play").getAttribute("aria-pressed") !== "true"));
  addEventListener("hashchange", () => { if (readAddress()) { draw(); $("explorer").scrollIntoView(); } });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  addEventListener("beforeprint", () => { for (const folded of document.querySelectorAll("details")) folded.open = true; });
  readAddress();
  draw();
  // The library takes longer to start than all the rest: the page is there to read before it does.
  const startLibrary = () => {
    const library = document.createElement("script");
    library.textContent = $("plotly").textContent;
    document.head.append(library);
    draw();
    for (const id of ["error-plot", "energy-plot", "motion-plot"]) {
      $(id).on("plotly_legendclick", (e) => { const name = e.data[e.curveNumber].meta; if (name) toggle(name); return false; });
      $(id).on("plotly_legenddoubleclick", () => false);
    }
  };
  requestAnimationFrame(() => setTimeout(startLibrary));
})();
