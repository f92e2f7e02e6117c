/* The report's charts, map and cursor. The data are in the element #data; Plotly draws. */
(function () {
  "use strict";

  const FONT = getComputedStyle(document.body).fontFamily;
  const INK = "#1a1a1a", GRAY = "#8a8a8a", PALE = "#c4c4c4";
  const A = "#0072b2", B = "#d55e00", GREEN = "#009e73", PURPLE = "#a0568a";
  // Viridis, and a diverging scale with gray in the middle, because white would hide the line.
  const RISING = ["#440154", "#414487", "#2a788e", "#22a884", "#7ad151", "#fde725"];
  const SIGNED = ["#d55e00", "#e08f52", "#bdbdbd", "#5b9bc4", "#0072b2"];
  const data = JSON.parse(document.getElementById("data").textContent);
  const byId = (id) => document.getElementById(id);
  // Plotly interprets tags in texts.
  const plain = (text) => text.replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");

  function unpack(packed) {
    if (!packed) return null;
    const bytes = atob(packed.b), values = new Array(bytes.length / 2);
    for (let i = 0; i < values.length; i++) {
      let q = bytes.charCodeAt(2 * i) | (bytes.charCodeAt(2 * i + 1) << 8);
      if (q > 32767) q -= 65536;
      values[i] = q === -32768 ? null : packed.o + packed.k * q;
    }
    return values;
  }

  const both = (a, b, f) => a.map((x, i) => (x === null || b[i] === null ? null : f(x, b[i])));
  const each = (a, f) => a.map((x) => (x === null ? null : f(x)));
  const known = (a) => a && a.some((x) => x !== null);

  // -- tracks and laps -------------------------------------------------------------------------

  const tracks = data.tracks.map((raw) => {
    const track = { length: raw.length, n: raw.n, corners: raw.corners };
    for (const key of ["x", "y", "cos", "sin", "speed", "grip", "left", "right"]) {
      track[key] = unpack(raw[key]);
    }
    track.s = track.x.map((_, i) => (raw.length * i) / (raw.n - 1));
    return track;
  });
  const planned = data.runs.map((run) => unpack(run.planned));

  function limitAt(limit, v) {
    const step = limit.v[1], i = Math.min(Math.floor(v / step), limit.v.length - 2);
    const part = Math.min(Math.max(v / step - i, 0), 1);
    return limit.a[i] + part * (limit.a[i + 1] - limit.a[i]);
  }

  const opened = new Map();
  function lapOf(r, k) {
    const key = r + ":" + k;
    if (opened.has(key)) return opened.get(key);
    const run = data.runs[r], raw = run.laps[k], track = tracks[run.track];
    const lap = { run: r, index: k, track, number: raw.number, total: raw.total };
    lap.time = both(unpack(raw.residual), track.s, (x, s) => x + (raw.total * s) / track.length);
    for (const name of ["v", "v_command", "d", "steering", "steering_table", "a_lat", "a_lon"]) {
      lap[name] = unpack(raw[name]);
    }
    lap.x = lap.d.map((d, i) => (d === null ? null : track.x[i] - d * track.sin[i]));
    lap.y = lap.d.map((d, i) => (d === null ? null : track.y[i] + d * track.cos[i]));
    lap.limit = run.limit ? each(lap.v, (v) => limitAt(run.limit, v)) : null;
    lap.grip = lap.limit && both(lap.a_lat, lap.limit, (a, most) => (100 * Math.abs(a)) / most);
    lap.understeer = both(lap.steering, lap.steering_table, (own, table) => own - table);
    // Positive if the car steers more than the table, in either direction.
    lap.understeer = lap.understeer.map((u, i) =>
      u === null ? null : u * Math.sign(lap.a_lat[i] || 1));
    lap.speedError = both(lap.v, lap.v_command, (v, command) => v - command);
    const time = raw.time === null ? "" : " (" + raw.time.toFixed(3) + " s)";
    lap.title = (data.runs.length > 1 ? run.name + ", " : "") + "lap " + raw.number + time;
    opened.set(key, lap);
    return lap;
  }

  const comparable = (r) => data.runs.map((_, q) => q).filter(
    (q) => data.runs[q].track === data.runs[r].track && data.runs[q].laps.length);
  const first = data.runs.findIndex((run) => run.laps.length);
  const state = { a: null, b: null, all: false, color: "v", s: 0, zoom: null };
  if (first < 0) {
    for (const id of ["over-distance", "grip", "right"]) byId(id).remove();
    return setUpPlaces();
  }

  function choose() {
    state.a = lapOf(first, data.runs[first].best);
    const others = comparable(first).filter((r) => r !== first);
    if (others.length) {
      state.b = lapOf(others[0], data.runs[others[0]].best);
    } else {
      // The median lap against the best; laps that do not count only if there are no others.
      const run = data.runs[first];
      let whole = run.laps.map((_, k) => k)
        .filter((k) => run.laps[k].time !== null && k !== run.best)
        .sort((i, j) => run.laps[i].time - run.laps[j].time);
      if (whole.some((k) => run.laps[k].valid)) whole = whole.filter((k) => run.laps[k].valid);
      state.b = state.a;
      if (whole.length) state.a = lapOf(first, whole[Math.floor((whole.length - 1) / 2)]);
    }
  }

  function fill(select, laps, chosen) {
    select.replaceChildren();
    for (const [r, k] of laps) {
      const option = document.createElement("option");
      option.value = r + ":" + k;
      option.textContent = lapOf(r, k).title;
      option.selected = chosen.run === r && chosen.index === k;
      select.append(option);
    }
  }

  function allLaps(runs) {
    return runs.flatMap((r) => data.runs[r].laps.map((_, k) => [r, k]));
  }

  // -- charts ----------------------------------------------------------------------------------

  const CHARTS = [
    { key: "delta", title: "A behind B [s]" },
    { key: "v", title: "speed [m/s]" },
    { key: "d", title: "deviation [m], left +" },
    { key: "steering", title: "steering [rad], left +" },
    { key: "a_lat", title: "lateral acceleration [m/s²]" },
  ];
  const axis = (i) => (i ? "y" + (i + 1) : "y");

  function line(i, y, color, name, more) {
    return { type: "scatter", mode: "lines", x: state.a.track.s, y, yaxis: axis(i),
      hoverinfo: "skip", name: plain(name), line: Object.assign({ color, width: 1.8 }, more) };
  }

  function faint(i, key) {
    const xs = [], ys = [];
    for (const [r, k] of allLaps(comparable(state.a.run))) {
      const lap = lapOf(r, k), values = key === "delta" ? deltaOf(lap) : lap[key];
      if (!known(values)) continue;
      xs.push(...lap.track.s, null);
      ys.push(...values, null);
    }
    return { type: "scatter", mode: "lines", x: xs, y: ys, yaxis: axis(i), hoverinfo: "skip",
      line: { color: PALE, width: 0.8 }, name: "all laps" };
  }

  const deltaOf = (lap) => both(lap.time, state.b.time, (own, other) => own - other);

  function traces() {
    const a = state.a, b = state.b, track = a.track, found = [];
    const dash = (kind, width) => ({ dash: kind, width: width || 1.4 });
    const add = (i, y, color, name, more) => { if (known(y)) found.push(line(i, y, color, name, more)); };
    if (state.all) CHARTS.forEach((chart, i) => found.push(faint(i, chart.key)));
    const plan = planned[a.run];
    add(1, track.grip, GREEN, "within the grip", dash("dot", 1.6));
    add(1, track.speed, GRAY, "raceline", dash("dash"));
    if (plan) add(1, plan, PURPLE, "asked for", dash("dashdot"));
    add(1, a.v_command, "#56b4e9", "commanded", { width: 1.1 });
    if (track.left) {
      add(2, track.left, INK, "left wall", { width: 1.2 });
      add(2, each(track.right, (d) => -d), INK, "right wall", { width: 1.2 });
    }
    add(3, a.steering_table, GREEN, "what the table has", dash("dot", 1.6));
    if (a.limit) {
      add(4, a.limit, GREEN, "limit of the tires", dash("dot", 1.6));
      add(4, each(a.limit, (x) => -x), GREEN, "", dash("dot", 1.6));
    }
    if (b !== a) {
      for (const [i, key] of [[1, "v"], [2, "d"], [3, "steering"], [4, "a_lat"]]) {
        add(i, b[key], B, b.title, dash("dash", 1.8));
      }
    }
    add(0, deltaOf(a), A, a.title);
    for (const [i, key] of [[1, "v"], [2, "d"], [3, "steering"], [4, "a_lat"]]) {
      add(i, a[key], A, a.title);
    }
    return found;
  }

  const fontSize = () => (window.innerWidth >= 1800 ? 17 : 13);
  const narrow = () => window.innerWidth < 600;

  function layout() {
    // Above each chart are its title and legend, on a phone on separate lines.
    const room = (narrow() ? 2.7 : 1.7) * fontSize(), bottom = 40;
    const gap = room / (byId("charts").clientHeight - room - bottom);
    const height = (1 - gap * (CHARTS.length - 1)) / CHARTS.length;
    const result = {
      margin: { l: 58, r: 8, t: room, b: bottom }, showlegend: false, hovermode: false,
      dragmode: window.matchMedia("(pointer: coarse)").matches ? false : "zoom",
      font: { family: FONT, size: fontSize(), color: INK }, paper_bgcolor: "#fff",
      plot_bgcolor: "#fff", annotations: [], shapes: [],
      xaxis: { title: { text: "distance from the start line [m]", standoff: 6 }, anchor: axis(4),
        range: state.zoom || [0, state.a.track.length], zeroline: false, gridcolor: "#ececec",
        automargin: false },
    };
    CHARTS.forEach((chart, i) => {
      const top = 1 - i * (height + gap);
      result["yaxis" + (i ? i + 1 : "")] = { domain: [Math.max(top - height, 0), top],
        fixedrange: true, gridcolor: "#ececec", zeroline: i !== 1, zerolinecolor: "#b5b5b5",
        nticks: 6, exponentformat: "none" };
      result.annotations.push({ xref: "paper", yref: "paper", x: 0, y: top, xanchor: "left",
        yanchor: "bottom", yshift: narrow() ? fontSize() : 0, showarrow: false, borderpad: 0,
        text: "<b>" + chart.title + "</b>" });
    });
    for (const corner of state.a.track.corners) {
      result.shapes.push({ type: "line", xref: "x", yref: "paper", x0: corner.apex,
        x1: corner.apex, y0: 0, y1: 1, layer: "below", line: { color: "#dedede", width: 3 } });
    }
    legend(result, height, gap);
    return result;
  }

  function legend(result, height, gap) {
    // Labels for the lines that are not one of the two laps.
    const say = (i, entries) => {
      const text = entries.filter((e) => e).map(([color, name]) =>
        `<span style="color:${color}">${name}</span>`).join("   ");
      if (text) result.annotations.push({ xref: "paper", yref: "paper", x: narrow() ? 0 : 1,
        y: 1 - i * (height + gap), xanchor: narrow() ? "left" : "right", yanchor: "bottom",
        showarrow: false, borderpad: 0, text, font: { size: fontSize() - (narrow() ? 3 : 1) } });
    };
    const a = state.a, track = a.track;
    say(1, [track.speed && [GRAY, "-- raceline"], planned[a.run] && [PURPLE, "-· asked for"],
      known(a.v_command) && ["#2b7fb0", "— commanded"], track.grip && [GREEN, "··· within the grip"]]);
    if (track.left) {
      say(2, [[INK, nearestWall() < deviationShown() ? "— walls" : "the walls are farther away"]]);
    }
    say(3, [known(a.steering_table) && [GREEN, "··· what the table has for this turning"]]);
    say(4, [a.limit && [GREEN, "··· limit of the tires"]]);
  }

  const options = { displayModeBar: false, responsive: true, doubleClick: "reset", scrollZoom: false };

  const nearestWall = () => Math.min(...state.a.track.left.concat(state.a.track.right)
    .filter((x) => x !== null));

  // Largest deviation shown: up to the nearest wall, unless that would flatten the line.
  function deviationShown() {
    const d = state.a.d.concat(state.b.d).filter((x) => x !== null);
    const most = Math.max(0.1, ...d.map(Math.abs));
    const wall = state.a.track.left ? 1.3 * nearestWall() : 0;
    return wall < 5 * most ? Math.max(1.6 * most, wall) : 1.6 * most;
  }

  function fit(result) {
    result.yaxis3.range = [-deviationShown(), deviationShown()];
    const asked = state.a.a_lat.concat(state.b.a_lat).filter((x) => x !== null).map(Math.abs);
    if (asked.length) {
      const least = state.a.limit ? Math.min(...state.a.limit.filter((x) => x !== null)) : 0;
      const top = 1.25 * Math.max(...asked, Math.min(least, 1.5 * Math.max(...asked)));
      result.yaxis5.range = [-top, top];
    }
    if (state.a.limit) {
      const speeds = state.a.v.concat(state.b.v, state.a.track.speed || []).filter((x) => x !== null);
      result.yaxis2.range = [0.85 * Math.min(...speeds), 1.12 * Math.max(...speeds)];
    }
    return result;
  }

  function drawCharts() {
    Plotly.react("charts", traces(), fit(layout()), options);
    place();
  }

  // -- map -------------------------------------------------------------------------------------

  const COLORS = {
    v: { title: "speed", unit: "m/s", values: (lap) => lap.v },
    loss: { title: "time lost per meter", unit: "ms/m", signed: true, values: lossOf, flip: true },
    d: { title: "deviation, left +", unit: "m", signed: true, values: (lap) => lap.d },
    grip: { title: "grip used", unit: "%", values: (lap) => lap.grip },
    understeer: { title: "steering beyond the table", unit: "rad", signed: true, flip: true,
      values: (lap) => lap.understeer },
    speedError: { title: "speed above the command", unit: "m/s", signed: true, flip: true,
      values: (lap) => lap.speedError },
    a_lat: { title: "lateral acceleration, left +", unit: "m/s²", signed: true,
      values: (lap) => lap.a_lat },
    a_lon: { title: "longitudinal acceleration", unit: "m/s²", signed: true,
      values: (lap) => lap.a_lon },
  };

  function lossOf(lap) {
    const delta = deltaOf(lap), s = lap.track.s, n = s.length, reach = Math.max(1, Math.round(n / 80));
    return delta.map((_, i) => {
      const from = Math.max(i - reach, 0), to = Math.min(i + reach, n - 1);
      if (delta[from] === null || delta[to] === null) return null;
      return (1000 * (delta[to] - delta[from])) / (s[to] - s[from]);
    });
  }

  function fillColors() {
    const select = byId("color");
    select.replaceChildren();
    for (const [key, color] of Object.entries(COLORS)) {
      if (!known(color.values(state.a))) continue;
      const option = document.createElement("option");
      option.value = key;
      option.textContent = color.title;
      option.selected = key === state.color;
      select.append(option);
    }
    state.color = select.value;
  }

  function drawMap() {
    const a = state.a, track = a.track, color = COLORS[state.color], values = color.values(a);
    const numbers = values.filter((x) => x !== null).sort((p, q) => p - q);
    let low = numbers[Math.floor(0.01 * (numbers.length - 1))];
    let high = numbers[Math.ceil(0.99 * (numbers.length - 1))];
    if (color.signed) { high = Math.max(Math.abs(low), Math.abs(high)) || 1; low = -high; }
    if (!(high > low)) high = low + 1;
    const base = color.signed ? SIGNED : RISING, colors = color.flip ? base.slice().reverse() : base;
    const scale = colors.map((c, i) => [i / (colors.length - 1), c]);
    const found = [];
    const wall = (d, sign) => ({ type: "scatter", mode: "lines", hoverinfo: "skip",
      line: { color: GRAY, width: 1.5 },
      x: track.x.map((x, i) => x - sign * d[i] * track.sin[i]),
      y: track.y.map((y, i) => y + sign * d[i] * track.cos[i]) });
    if (track.left) found.push(wall(track.left, 1), wall(track.right, -1));
    found.push({ type: "scatter", mode: "lines", x: track.x, y: track.y, hoverinfo: "skip",
      line: { color: PALE, width: 1, dash: "dash" } });
    found.push({ type: "scatter", mode: "markers", x: dense(a.x), y: dense(a.y), hoverinfo: "skip",
      marker: { size: window.innerWidth >= 1800 ? 8 : 6, color: dense(values), colorscale: scale,
        cmin: low, cmax: high } });
    const ends = track.left ? [-track.right[0], track.left[0]] : [-0.6, 0.6];
    const start = { type: "scatter", mode: "lines", hoverinfo: "skip",
      line: { color: INK, width: 3 },
      x: ends.map((d) => track.x[0] - d * track.sin[0]),
      y: ends.map((d) => track.y[0] + d * track.cos[0]) };
    found.push(start);
    const marks = placesShown().map((p, i) => {
      const k = indexAt(track, ((p.begin + (p.end > p.begin ? p.end : p.end + track.length)) / 2) % track.length);
      return { x: track.x[k], y: track.y[k], text: "<b>" + (i + 1) + "</b>", showarrow: true,
        arrowhead: 0, arrowwidth: 1, ax: 26 * track.sin[k] * inward(track, k), ay: 26 * track.cos[k] * inward(track, k),
        bgcolor: "#fff", bordercolor: INK, borderpad: 2, font: { size: fontSize() } };
    });
    Plotly.react("map", found, { margin: { l: 4, r: 4, t: 4, b: 4 }, showlegend: false,
      hovermode: false, dragmode: false, annotations: marks, paper_bgcolor: "#fff",
      plot_bgcolor: "#fff", font: { family: FONT, size: fontSize(), color: INK },
      xaxis: { visible: false, fixedrange: true },
      yaxis: { visible: false, fixedrange: true, scaleanchor: "x" } }, options);
    const bar = byId("scale");
    bar.replaceChildren();
    const text = (t) => { const e = document.createElement("span"); e.textContent = t; return e; };
    const ramp = document.createElement("span");
    ramp.className = "ramp";
    ramp.style.background = "linear-gradient(to right, " + colors.join(", ") + ")";
    const digits = high - low < 2 ? 2 : high - low < 20 ? 1 : 0;
    bar.append(text(low.toFixed(digits)), ramp, text(high.toFixed(digits) + " " + color.unit));
    place();
  }

  // Values with interpolated ones in between, so that the marks of few places touch.
  function dense(values) {
    const parts = Math.ceil(600 / values.length), all = [];
    for (let i = 0; i + 1 < values.length; i++) {
      const one = values[i], next = values[i + 1];
      for (let k = 0; k < parts; k++) {
        all.push(one === null || next === null ? null : one + ((next - one) * k) / parts);
      }
    }
    return all;
  }

  // Side of the line with more room for a label: away from the middle of the track.
  function inward(track, k) {
    const mx = track.x.reduce((p, q) => p + q) / track.n, my = track.y.reduce((p, q) => p + q) / track.n;
    const left = (mx - track.x[k]) * -track.sin[k] + (my - track.y[k]) * track.cos[k];
    return left > 0 ? 1 : -1;
  }

  // -- g-g -------------------------------------------------------------------------------------

  function drawGrip() {
    const found = [], cloud = (lap, color, symbol) => found.push({ type: "scatter", mode: "markers",
      x: lap.a_lat, y: lap.a_lon, hoverinfo: "skip", name: plain(lap.title),
      marker: { color, size: 5, symbol, opacity: 0.75 } });
    const limit = data.runs[state.a.run].limit;
    if (limit) {
      const speeds = state.a.v.filter((v) => v !== null).sort((p, q) => p - q);
      const at = [0.02, 0.5, 0.98].map((share) => speeds[Math.floor(share * (speeds.length - 1))]);
      const limits = at.map((v) => limitAt(limit, v));
      const same = Math.max(...limits) - Math.min(...limits) < 0.05 * limits[1];
      at.forEach((v, i) => {
        if (same && i !== 1) return; // one line if speed hardly matters
        const most = limits[i], x = [], y = [];
        for (let k = 0; k <= 120; k++) {
          const angle = (k * Math.PI) / 60, up = Math.sin(angle);
          x.push(most * Math.cos(angle));
          y.push(up * (up > 0 ? limit.drive : limit.brake));
        }
        found.push({ type: "scatter", mode: "lines", x, y, hoverinfo: "skip",
          name: same ? "limit" : "limit at " + v.toFixed(1) + " m/s",
          line: { color: GREEN, width: 1.6, dash: ["dot", "dash", "solid"][i] } });
      });
    }
    if (state.b !== state.a) cloud(state.b, B, "x-thin-open");
    cloud(state.a, A, "circle");
    Plotly.react("gg", found, { margin: { l: 55, r: 10, t: 10, b: 45 }, hovermode: false,
      dragmode: false, font: { family: FONT, size: fontSize(), color: INK },
      legend: { orientation: "h", x: 0, y: 1.02, yanchor: "bottom", traceorder: "reversed" },
      paper_bgcolor: "#fff", plot_bgcolor: "#fff",
      xaxis: { title: { text: "lateral acceleration, left + [m/s²]" }, gridcolor: "#ececec",
        zerolinecolor: "#b5b5b5" },
      yaxis: { title: { text: "longitudinal [m/s²]" }, gridcolor: "#ececec",
        zerolinecolor: "#b5b5b5", scaleanchor: "x" } }, options);
  }

  // -- cursor ----------------------------------------------------------------------------------

  const cursor = document.createElement("div"), dotA = document.createElement("div");
  cursor.className = "cursor";
  dotA.className = "dot";

  const indexAt = (track, s) => Math.min(Math.max(Math.round((s / track.length) * (track.n - 1)), 0), track.n - 1);

  function place() {
    const charts = byId("charts"), map = byId("map"), track = state.a.track;
    const k = indexAt(track, state.s);
    if (charts._fullLayout && charts._fullLayout.xaxis) {
      const x = charts._fullLayout.xaxis, size = charts._fullLayout._size;
      const at = x._offset + x.d2p(state.s);
      cursor.style.display = at < x._offset - 1 || at > x._offset + x._length + 1 ? "none" : "";
      cursor.style.left = at + "px";
      cursor.style.top = size.t + "px";
      cursor.style.height = size.h + "px";
      if (!cursor.parentNode) charts.append(cursor);
    }
    if (map._fullLayout && map._fullLayout.xaxis && state.a.x[k] !== null) {
      const { xaxis, yaxis } = map._fullLayout;
      dotA.style.left = xaxis._offset + xaxis.d2p(state.a.x[k]) + "px";
      dotA.style.top = yaxis._offset + yaxis.d2p(state.a.y[k]) + "px";
      if (!dotA.parentNode) map.append(dotA);
    }
    readout(k);
    byId("slider").value = Math.round((1000 * state.s) / track.length);
  }

  const ROWS = [
    ["speed", "v", 2, "m/s"], ["commanded", "v_command", 2, "m/s"], ["deviation", "d", 3, "m"],
    ["steering", "steering", 3, "rad"], ["table has", "steering_table", 3, "rad"],
    ["lateral", "a_lat", 1, "m/s²"], ["grip used", "grip", 0, "%"],
  ];

  function readout(k) {
    const body = byId("readout").tBodies[0], two = state.b !== state.a;
    const show = (x, digits) => (x === null || x === undefined ? "–"
      : x.toFixed(digits).replace(/^-(0\.?0*)$/, "$1"));
    const rows = [["s = " + state.a.track.s[k].toFixed(1) + " m", "A", two ? "B" : ""]];
    if (two) rows.push(["A behind B", show(deltaOf(state.a)[k], 3) + " s", ""]);
    for (const [title, key, digits, unit] of ROWS) {
      if (!known(state.a[key]) && !known(state.b[key])) continue;
      const cell = (lap) => (lap[key] ? show(lap[key][k], digits) + " " + unit : "–");
      rows.push([title, cell(state.a), two ? cell(state.b) : ""]);
    }
    body.replaceChildren(...rows.map((cells) => {
      const row = document.createElement("tr");
      row.append(...cells.map((text) => {
        const cell = document.createElement("td");
        cell.textContent = text;
        return cell;
      }));
      return row;
    }));
  }

  function moveTo(s) {
    state.s = Math.min(Math.max(s, 0), state.a.track.length);
    place();
  }

  function listen() {
    const charts = byId("charts"), map = byId("map");
    const overCharts = (event) => {
      const point = event.touches ? event.touches[0] : event, x = charts._fullLayout.xaxis;
      moveTo(x.p2d(point.clientX - charts.getBoundingClientRect().left - x._offset));
    };
    const overMap = (event) => {
      const point = event.touches ? event.touches[0] : event, box = map.getBoundingClientRect();
      const { xaxis, yaxis } = map._fullLayout, lap = state.a;
      const x = point.clientX - box.left - xaxis._offset, y = point.clientY - box.top - yaxis._offset;
      let best = 0, least = Infinity;
      lap.x.forEach((value, k) => {
        if (value === null) return;
        const far = (xaxis.d2p(value) - x) ** 2 + (yaxis.d2p(lap.y[k]) - y) ** 2;
        if (far < least) { least = far; best = k; }
      });
      moveTo(lap.track.s[best]);
    };
    for (const kind of ["mousemove", "touchstart", "touchmove"]) {
      charts.addEventListener(kind, overCharts, { passive: true });
      map.addEventListener(kind, overMap, { passive: true });
    }
    byId("slider").addEventListener("input", (event) =>
      moveTo((event.target.value / 1000) * state.a.track.length));
    charts.on("plotly_relayout", (changed) => {
      if ("xaxis.range[0]" in changed) state.zoom = charts.layout.xaxis.range.slice();
      if (changed["xaxis.autorange"]) zoomTo(null);
      place();
    });
    charts.on("plotly_doubleclick", () => zoomTo(null));
    charts.on("plotly_afterplot", place);
    map.on("plotly_afterplot", place);
    window.addEventListener("resize", place);
    byId("whole").addEventListener("click", () => zoomTo(null));
    byId("all-laps").addEventListener("change", (event) => {
      state.all = event.target.checked;
      drawCharts();
    });
    byId("color").addEventListener("change", (event) => {
      state.color = event.target.value;
      drawMap();
    });
    const picked = (event) => lapOf(...event.target.value.split(":").map(Number));
    byId("lap-a").addEventListener("change", (event) => { state.a = picked(event); drawAll(); });
    byId("lap-b").addEventListener("change", (event) => { state.b = picked(event); drawAll(); });
    for (const chip of document.querySelectorAll(".lap[data-lap]")) {
      chip.addEventListener("click", () => {
        const r = Number(chip.dataset.run), k = shownIndex(r, Number(chip.dataset.lap));
        if (k < 0) return;
        state.a = lapOf(r, k);
        drawAll();
      });
    }
    // The paper's width differs from the screen's.
    window.addEventListener("beforeprint", () => resize(680, 850));
    window.addEventListener("afterprint", () => resize());
  }

  function resize(width, height) {
    for (const id of ["charts", "map", "gg"]) {
      const box = byId(id);
      if (!box || !box._fullLayout) continue;
      if (width) Plotly.relayout(box, { width: id === "map" ? 400 : id === "gg" ? 520 : width,
        height: id === "charts" ? height : 340 });
      else Plotly.relayout(box, { width: null, height: null, autosize: true });
    }
  }

  const shownIndex = (r, lap) => data.runs[r].laps.findIndex((l) => l.index === lap);

  function zoomTo(range) {
    state.zoom = range;
    Plotly.relayout("charts", { "xaxis.range": range || [0, state.a.track.length] });
  }

  // -- places ----------------------------------------------------------------------------------

  function placesShown() {
    const list = document.querySelector(".places:not([hidden])");
    if (!list || !list.dataset.reference) return [];
    return data.places[list.dataset.run][list.dataset.reference];
  }

  function setUpPlaces() {
    const runs = byId("place-run"), select = byId("place-reference");
    const lists = Array.from(document.querySelectorAll(".places"));
    const show = () => {
      const r = runs ? runs.value : "0";
      for (const list of lists) {
        list.hidden = list.dataset.run !== r ||
          (list.dataset.reference !== undefined && list.dataset.reference !== select.value);
      }
      if (first >= 0 && byId("map")._fullLayout) drawMap();
    };
    const fillReferences = () => {
      const r = runs ? runs.value : "0";
      select.replaceChildren(...lists.filter((l) => l.dataset.run === r && l.dataset.name)
        .map((l) => new Option(l.dataset.name, l.dataset.reference)));
      select.parentNode.hidden = !select.options.length;
      show();
    };
    if (runs) runs.addEventListener("change", fillReferences);
    select.addEventListener("change", show);
    for (const button of document.querySelectorAll(".zoom")) {
      button.addEventListener("click", () => {
        if (first < 0) return;
        const begin = Number(button.dataset.begin), end = Number(button.dataset.end);
        const length = state.a.track.length, around = 0.15 * (end - begin) + 0.5;
        // A place across the start line: its longer part.
        const [from, to] = end <= length ? [begin, end]
          : end - length > length - begin ? [0, end - length] : [begin, length];
        moveTo((from + to) / 2);
        zoomTo([Math.max(from - around, 0), Math.min(to + around, length)]);
      });
    }
    fillReferences();
  }

  // -- start -----------------------------------------------------------------------------------

  function drawAll() {
    const runs = comparable(state.a.run);
    if (!runs.includes(state.b.run)) state.b = lapOf(state.a.run, data.runs[state.a.run].best);
    fill(byId("lap-a"), allLaps(data.runs.map((_, r) => r)), state.a);
    fill(byId("lap-b"), allLaps(runs), state.b);
    for (const chip of document.querySelectorAll(".lap[data-lap]")) {
      const r = Number(chip.dataset.run), k = shownIndex(r, Number(chip.dataset.lap));
      chip.classList.toggle("shown-a", state.a.run === r && state.a.index === k);
      chip.classList.toggle("shown-b", state.b.run === r && state.b.index === k);
      if (k < 0) chip.disabled = true;
    }
    fillColors();
    drawCharts();
    drawMap();
    drawGrip();
  }

  choose();
  setUpPlaces();
  drawAll();
  listen();
  moveTo(0);
})();
