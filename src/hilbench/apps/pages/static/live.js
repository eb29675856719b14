"use strict";
// The page of a running bench: shows what its server has received on the bus, and asks for what a person has confirmed.
window.session.then((known) => {
  if (!known || !document.getElementById("all")) return;
  const $ = (id) => document.getElementById(id);
  const make = (tag, words = "", kind = "") => {
    const made = document.createElement(tag);
    made.textContent = words;
    if (kind) made.className = kind;
    return made;
  };
  const { colour, missing, minus, ticks, axis, beginning, extent, height } = window.axes;
  const digits = (value, least = 4) => {
    const size = Math.abs(value);
    return size >= 1000 ? 0 : size >= 100 ? 1 : size >= 10 ? 2 : Math.min(least, 3);
  };
  const number = (value) => (missing(value) || !Number.isFinite(value) ? "–" : minus(value.toFixed(digits(value))));
  const rounded = (value) => minus(String(Number(value.toPrecision(4))));
  const seconds = (t) => (missing(t) ? "" : minus(t.toFixed(t >= 100 ? 1 : 2)) + " s");

  const isReplay = "replay" in document.body.dataset;

  // -- what has come ---------------------------------------------------------------------------------------

  const KEPT = [6000, 18000]; // stretches of each length
  let layout = null, state = null, generation = -1;
  const empty = () => ({ t: [], low: layout.signals.map(() => []), high: layout.signals.map(() => []) });
  let levels = [], past = null;

  const takeStretches = (buffer) => {
    const [level, of, count, columns] = new Uint32Array(buffer, 0, 4);
    const t = new Float64Array(buffer, 16, count);
    const values = new Float32Array(buffer, 16 + 8 * count, 2 * count * columns);
    if (of !== generation && level < KEPT.length) {
      generation = of;
      levels = KEPT.map(empty);
      live();
    }
    if (level >= KEPT.length) {
      if (of !== generation) return;
      past = empty();
      fill(past, t, values, count, columns);
      draw();
      return;
    }
    const store = levels[level];
    fill(store, t, values, count, columns);
    const over = store.t.length - KEPT[level];
    if (over > KEPT[level] / 8) for (const column of [store.t, ...store.low, ...store.high]) column.splice(0, over);
  };
  const fill = (store, t, values, count, columns) => {
    for (let k = 0; k < count; k++) store.t.push(t[k]);
    for (let c = 0; c < columns; c++) {
      const low = store.low[c], high = store.high[c];
      for (let k = 0; k < count; k++) {
        low.push(values[c * count + k]);
        high.push(values[(columns + c) * count + k]);
      }
    }
  };

  // -- plots -----------------------------------------------------------------------------------------------

  const WINDOWS = [[10, "10 s"], [30, "30 s"], [120, "2 min"], [600, "10 min"], [3600, "1 h"]];
  const FINE_S = 110, LEAST_S = 5, PLOT_PX = 190, AXIS_PX = 62;
  let windowS = 30, held = null; // [from, to] while paused
  let plots = [], drawnAt = 0;

  const shown = () => {
    if (held) return held;
    const t = levels.length ? levels[0].t : [], last = t.length ? t[t.length - 1] : 0;
    const first = levels.length && levels[1].t.length ? Math.min(levels[1].t[0], t[0] ?? 0) : t[0] ?? 0;
    const from = Math.max(last - windowS, first); // of a run that has just begun what there is
    return [from, Math.max(last, from + Math.min(windowS, LEAST_S))];
  };
  const storeFor = (from, to) => {
    if (held && past && past.t.length > 1) return past;
    const fine = levels[0];
    return fine.t.length && to - from <= FINE_S && fine.t[0] <= from + 1 ? fine : levels[1];
  };
  const place = (t, at) => {
    let low = 0, high = t.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (t[middle] < at) low = middle + 1; else high = middle;
    }
    return low;
  };
  // Two points a stretch, its least and its largest value: whatever a spike is, it is there.
  const times = (store, first, last) => {
    const x = new Array(2 * (last - first));
    for (let k = first; k < last; k++) {
      const next = k + 1 < store.t.length ? store.t[k + 1] : store.t[k];
      x[2 * (k - first)] = store.t[k];
      x[2 * (k - first) + 1] = store.t[k] + 0.5 * Math.min(Math.max(next - store.t[k], 0), 0.4);
    }
    return x;
  };
  const curve = (store, first, last, column, scale, half = () => 0, side = 0) => {
    const y = new Array(2 * (last - first)), low = store.low[column], high = store.high[column];
    let before = NaN;
    for (let k = first; k < last; k++) {
      let a = side > 0 ? high[k] + half(k) : side < 0 ? low[k] - half(k) : low[k];
      let b = side === 0 ? high[k] : a;
      const middle = 0.5 * (a + b);
      if (middle < before) [a, b] = [b, a];
      before = middle;
      y[2 * (k - first)] = Number.isFinite(a) ? a / scale : null;
      y[2 * (k - first) + 1] = Number.isFinite(b) ? b / scale : null;
    }
    return y;
  };

  const markLevels = (u, levels) => {
    const { ctx, bbox } = u, ratio = devicePixelRatio;
    for (const [name, level] of Object.entries(levels)) {
      if (level === null) continue;
      for (const at of [level, -level]) {
        const y = u.valToPos(at, "y", true);
        ctx.strokeStyle = colour(name === "trip" ? "--bad" : "--close");
        ctx.lineWidth = ratio;
        ctx.setLineDash([8 * ratio, 4 * ratio]);
        ctx.beginPath();
        ctx.moveTo(bbox.left, y);
        ctx.lineTo(bbox.left + bbox.width, y);
        ctx.stroke();
      }
    }
  };
  const marks = (u) => {
    const { ctx, bbox } = u, ratio = devicePixelRatio;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    markLevels(u, u.plot.limits);
    ctx.font = `${11 * ratio}px system-ui, sans-serif`;
    ctx.textBaseline = "top";
    ctx.textAlign = "left";
    const [from, to] = shown();
    let free = -Infinity;
    for (const event of [...happened.values()].filter((e) => e.t_s !== null && e.t_s >= from && e.t_s <= to && e.weight !== "operator").sort((a, b) => a.t_s - b.t_s)) {
      const x = u.valToPos(event.t_s, "x", true);
      ctx.strokeStyle = ctx.fillStyle = colour(event.weight === "fault" ? "--bad" : event.weight === "warning" ? "--close" : "--purple");
      ctx.lineWidth = ratio;
      ctx.setLineDash([3 * ratio, 3 * ratio]);
      ctx.beginPath();
      ctx.moveTo(x, bbox.top);
      ctx.lineTo(x, bbox.top + bbox.height);
      ctx.stroke();
      if (u === plots[0] && x > free) {
        const words = event.text.length > 34 ? event.text.slice(0, 33) + "…" : event.text;
        ctx.fillText(words, x + 3 * ratio, bbox.top + 2 * ratio);
        free = x + ctx.measureText(words).width + 10 * ratio;
      }
    }
    ctx.restore();
  };
  const WIDER = 25; // of an estimate that has just begun, say
  const range = (plot) => (u, low, high) => height(low, high, u.extent, WIDER, Math.max(plot.least, plot.least_share * Math.abs(high)));

  const makePlot = (plot) => {
    const figure = make("figure");
    figure.append(make("h3", `${plot.title} in ${plot.unit}`));
    const at = make("div", "", "plot");
    figure.append(at);
    figure.dataset.plot = plot.name;
    $("grid").append(figure);
    const { series, bands } = beginning(plot.bands);
    for (const trace of plot.series)
      series.push({
        label: trace.name, width: trace.width, dash: trace.dash.length ? trace.dash : undefined, stroke: () => colour(trace.colour),
        points: { show: false }, value: (u, v) => (missing(v) ? "–" : number(v) + " " + plot.unit),
      });
    const numbered = { ...axis(11), values: ticks };
    const u = new uPlot({
      width: Math.max(at.clientWidth, 200), height: PLOT_PX, series, bands, padding: [8, 8, 0, 0],
      scales: { x: { time: false, range: () => shown() }, y: { range: range(plot) } },
      axes: [{ ...numbered, size: 26 }, { ...numbered, size: AXIS_PX }],
      legend: { markers: { width: 2 } },
      cursor: {
        sync: { key: "hilbench", scales: ["x", null] }, drag: { x: true, y: false, setScale: false }, points: { size: 5 },
        bind: { dblclick: () => () => { live(); return null; } },
      },
      hooks: {
        setSelect: [(self) => {
          if (self.select.width < 4) return;
          const from = self.posToVal(self.select.left, "x"), to = self.posToVal(self.select.left + self.select.width, "x");
          self.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
          hold(from, to);
        }],
        draw: [marks],
      },
    }, [[0], ...series.slice(1).map(() => [null])], at);
    u.plot = plot;
    u.root.querySelectorAll(".u-legend .u-series").forEach((row, k) => { if (k === 0 || k <= 2 * plot.bands.length) row.hidden = true; });
    return u;
  };
  const draw = () => {
    if (!layout || !levels.length || document.hidden) return;
    drawnAt = performance.now();
    const [from, to] = shown(), store = storeFor(from, to);
    const first = Math.max(place(store.t, from) - 1, 0), last = Math.min(place(store.t, to) + 1, store.t.length);
    const x = times(store, first, last), at = (name) => layout.signals.indexOf(name);
    for (const u of plots) {
      const data = [x];
      for (const band of u.plot.bands) {
        const column = at(band.signal), deviation = at(band.deviation);
        const half = (k) => (band.deviation ? 2 * store.high[deviation][k] : band.share * Math.abs(store.high[column][k]));
        for (const side of [1, -1]) data.push(curve(store, first, last, column, u.plot.scale, half, side));
      }
      u.extent = extent(data.slice(1));
      for (const trace of u.plot.series) {
        const y = curve(store, first, last, at(trace.signal), u.plot.scale);
        const stated = trace.deviation ? store.high[at(trace.deviation)] : null;
        data.push(stated ? y.map((v, k) => ((stated[first + (k >> 1)] === Infinity) === trace.estimated ? null : v)) : y);
      }
      u.setData(data, true);
      if (x.length && (u.cursor.left === undefined || u.cursor.left < 0)) u.setLegend({ idx: x.length - 1 }, false);
    }
  };
  const hold = (from, to) => {
    held = [from, to];
    past = null;
    $("pause").setAttribute("aria-pressed", "true");
    $("pause").textContent = "Back to now";
    say({ do: "past", from_s: from, to_s: to });
    draw();
  };
  const live = () => {
    held = past = null;
    $("pause").setAttribute("aria-pressed", "false");
    $("pause").textContent = "Pause";
    draw();
  };
  const pause = () => (held ? live() : hold(...shown()));
  const look = (length) => {
    windowS = length;
    for (const button of $("windows").children) button.setAttribute("aria-pressed", String(Number(button.dataset.length) === length));
    if (held) hold(held[1] - length, held[1]); else draw();
  };
  const beat = () => {
    if (!held && performance.now() - drawnAt > (windowS > 120 ? 500 : 90)) draw();
    requestAnimationFrame(beat);
  };

  // -- machine, figures, events ----------------------------------------------------------------------------

  const happened = new Map();
  let values = [], parts = new Map();
  const setText = (element, words) => { if (element.textContent !== words) element.textContent = words; };

  const build = () => {
    $("name").textContent = layout.name;
    $("name").title = layout.description;
    document.title = `${layout.replay ? `replay of ${layout.replay}` : layout.name} – hilbench`;
    if (isReplay) buildPaces();
    const svg = new DOMParser().parseFromString(layout.drawing, "image/svg+xml").documentElement;
    const drawing = document.importNode(svg, true);
    drawing.style.minWidth = `${0.55 * Number(svg.getAttribute("width"))}px`; // smaller nobody could read it
    $("drawing").replaceChildren(drawing);
    values = [...$("drawing").querySelectorAll("[data-signal]")];
    parts = new Map([...$("drawing").querySelectorAll("[data-part]")].map((g) => [g.dataset.part, g]));
    for (const [name, g] of parts) g.dataset.kind = layout.parts[name];
    for (const u of plots) u.destroy();
    $("grid").replaceChildren();
    plots = layout.plots.map(makePlot);
    $("windows").replaceChildren(...WINDOWS.map(([length, words]) => {
      const button = make("button", words);
      button.type = "button";
      button.dataset.length = length;
      button.setAttribute("aria-pressed", String(length === windowS));
      button.addEventListener("click", () => look(length));
      return button;
    }));
    $("nodes").tBodies[0].replaceChildren();
    $("events").replaceChildren();
    happened.clear();
    buildControls();
    levels = KEPT.map(empty);
    $("all").hidden = false;
    resize();
  };
  // A run that is played again: how fast, times the time in which it was run.
  const PACES = [[0, "stand still"], [0.2, "⅕ ×"], [1, "1 ×"], [4, "4 ×"], [null, "fast"]];
  const buildPaces = () => {
    $("paces").hidden = false;
    const again = make("button", "From the start");
    again.addEventListener("click", () => location.reload());
    $("paces").replaceChildren("Played", ...PACES.map(([pace, words]) => {
      const button = make("button", words);
      button.setAttribute("aria-pressed", String(pace === 1));
      button.addEventListener("click", () => {
        request({ do: "pace", pace }, () => { for (const each of $("paces").querySelectorAll("button")) each.setAttribute("aria-pressed", String(each === button)); });
      });
      return button;
    }), again);
  };
  const resize = () => {
    for (const u of plots) {
      const width = u.root.parentElement.clientWidth;
      if (width && width !== u.width) u.setSize({ width, height: PLOT_PX });
    }
  };

  const driveState = (node) => (!state.running ? "" : node.stale ? "stale" : !node.drive_state ? "" : /FAULT/.test(node.drive_state) ? "bad" : node.drive_state === "OPERATION ENABLED" ? "on" : "");
  const showMachine = () => {
    const limits = {};
    for (const plot of layout.plots) for (const trace of plot.series) limits[trace.signal] = plot.limits.warning * plot.scale;
    for (const text of values) {
      const value = state.running ? state.values[text.dataset.signal] : null;
      setText(text, text.dataset.before + (missing(value) ? "–" : `${number(value / text.dataset.per)} ${text.dataset.unit}`));
      text.classList.toggle("beyond", Math.abs(value) > limits[text.dataset.signal]);
    }
    const rows = $("nodes").tBodies[0];
    state.nodes.forEach((node, k) => {
      const row = rows.rows[k] ?? rows.insertRow();
      while (row.cells.length < 8) row.insertCell();
      const word = node.statusword === null ? "–" : node.statusword.toString(16).toUpperCase().padStart(4, "0") + "h";
      const absent = state.running ? (node.stale ? "STALE" : "–") : "–";
      const drive = layout.parts[node.part] === "virtual" ? node.drive_state ?? "" : node.drive_state ?? absent; // a virtual axis sends none
      [String(node.node_id), node.part, layout.parts[node.part], node.nmt_state ?? absent, drive, word, number(node.velocity_rad_s), number(node.torque_Nm)]
        .forEach((words, at) => setText(row.cells[at], words));
      for (const at of [5, 6, 7]) row.cells[at].className = "number";
      row.cells[4].dataset.state = driveState(node);
      if (parts.has(node.part)) parts.get(node.part).dataset.state = driveState(node);
    });
  };
  const figure = (words, bad) => make("span", words, bad ? "bad" : "");
  const showFigures = () => {
    const badge = $("condition");
    const condition = state.bus_problem ? "NO BUS" : state.condition.toUpperCase();
    setText(badge, isReplay ? `REPLAY: ${state.running ? "the bench ran" : condition}` : condition);
    badge.className = "badge" + (state.running ? " running" : ["ENDED", "not received"].includes(state.condition) ? "" : " over");
    setText($("clock"), state.t_s === null ? "" : `t = ${minus(state.t_s.toFixed(2))} s`);
    const why = state.bus_problem || (state.running || state.condition === "ENDED" ? "" : state.condition_text);
    $("why").hidden = !why;
    setText($("why"), why);
    const found = [];
    if (state.running) {
      if (state.bus_load_pct !== null) found.push(figure(`bus ${state.bus_load_pct.toFixed(0)} %`, state.bus_load_pct > 95));
      if (state.lockstep) found.push(figure("lockstep"));
      else if (state.jitter_p99_us !== null) found.push(figure(`jitter ${state.jitter_p99_us.toFixed(0)} µs p99, ${state.jitter_max_us.toFixed(0)} µs largest`, state.jitter_p99_us > 250));
      for (const [part, share] of Object.entries(state.late_samples_pct)) found.push(figure(`${part} ${share.toFixed(0)} % late`, true));
      if (state.model !== "as configured") found.push(figure(`twin: ${state.model}`));
    }
    if (state.dropped) found.push(figure(`${state.dropped} frames lost here`, true));
    for (const words of [`cycle ${state.cycles}`, layout.bus, state.run ?? ""]) found.push(make("span", words, "minor"));
    $("figures").replaceChildren(...found);
  };
  const showEnd = () => {
    const end = state.ended;
    $("ended").hidden = !end;
    if (!end || $("ended").dataset.of === `${state.run} ${end.report}`) return;
    $("ended").dataset.of = `${state.run} ${end.report}`;
    const words = [make("span", end.verdict, `verdict ${end.verdict}`), make("span", `${state.run}  `)];
    if (end.report) {
      const link = make("a", "report");
      link.href = end.report;
      link.target = "_blank";
      link.rel = "noopener";
      words.push(link);
    }
    const list = make("ul"), passed = end.criteria.filter((each) => each.passed).length;
    if (end.criteria.length) words.push(make("span", `${passed} of ${end.criteria.length} criteria passed`, "hint"));
    if (end.verdict === "completed") words.push(make("span", "nothing judged", "hint"));
    for (const text of end.faults) list.append(make("li", text, "result failed"));
    for (const each of end.criteria.filter((criterion) => !criterion.passed))
      list.append(make("li", `${each.name}: ${each.value === null ? "no value" : `${Number(each.value.toPrecision(4))} ${each.unit}`}, expected ${each.limit}`, "result failed"));
    $("ended").replaceChildren(...words, list);
  };
  const showEvents = (events) => {
    for (const event of events) {
      const line = happened.get(event.place)?.line ?? $("events").insertBefore(make("li"), $("events").firstChild);
      happened.set(event.place, { ...event, line });
      line.replaceChildren(make("time", seconds(event.t_s)), make("span", `${event.source}: ${event.text}`, event.weight));
    }
    while ($("events").children.length > 400) $("events").lastChild.remove();
  };

  // -- control ---------------------------------------------------------------------------------------------

  const buildControls = () => {
    $("quantities").replaceChildren(...layout.quantities.map((quantity) => {
      const row = make("div", "", "quantity"), what = make("div", "", "what");
      const field = make("input"), preview = make("button", "What if"), set = make("button", "Set…");
      field.type = "number";
      field.step = "any";
      field.min = quantity.low;
      field.max = quantity.high;
      field.id = `field-${quantity.key}`;
      field.setAttribute("aria-label", quantity.title);
      preview.type = set.type = "button";
      preview.hidden = !quantity.foreseeable;
      set.dataset.needs = "control";
      set.id = `set-${quantity.key}`;
      what.append(make("span", quantity.title), make("span", "–", "now"));
      row.append(what, make("span", `${rounded(quantity.low)} to ${rounded(quantity.high)} ${quantity.unit}`, "range"), field, preview, set);
      const value = () => {
        const given = field.valueAsNumber; // NaN for an empty field
        if (given >= quantity.low && given <= quantity.high) return given;
        notify(`${quantity.title}: expected a number from ${rounded(quantity.low)} to ${rounded(quantity.high)} ${quantity.unit}`, false);
        field.focus();
        return null;
      };
      const foresee = (wanted) => {
        const shown = asking;
        $("preview").textContent = "looking ahead …";
        const sent = request({ do: "what_if", key: quantity.key, value: wanted }, (message) => { if (asking === shown) showFutures(message); });
        if (!sent) $("preview").textContent = "";
      };
      preview.addEventListener("click", () => {
        if (value() === null) return;
        ask(`What if ${quantity.title} went to ${value()} ${quantity.unit}?`, "", () => {});
        foresee(value());
      });
      const change = () => {
        if (value() === null) return;
        const wanted = value();
        ask(`Set ${quantity.title} to ${wanted} ${quantity.unit}? It is ${row.querySelector(".now").textContent}.`, "Set", () => request({ do: "set", key: quantity.key, value: wanted }));
        if (quantity.foreseeable) foresee(wanted);
      };
      set.addEventListener("click", change);
      field.addEventListener("keydown", (event) => { if (event.key === "Enter" && !set.disabled) change(); });
      row.quantity = quantity;
      return row;
    }));
    $("switches").replaceChildren(...layout.switches.map((each) => {
      const row = make("div", "", "quantity");
      row.append(make("span", each.title));
      for (const [words, yes] of [["Yes…", true], ["No…", false]]) {
        const button = make("button", words);
        button.type = "button";
        button.dataset.needs = "control";
        button.addEventListener("click", () => ask(`${each.title}: ${yes ? each.yes : each.no}?`, yes ? "Yes" : "Refuse", () => request({ do: "answer", key: each.key, yes })));
        row.append(button);
      }
      return row;
    }));
  };
  const showControl = () => {
    const { name, mine, left_s } = state.control;
    const left = left_s === null ? "" : left_s > 90 ? `${Math.ceil(left_s / 60)} min` : `${Math.ceil(left_s)} s`;
    setText($("holder"), mine ? `You control; free again after ${left} without an action.` : name ? `${name} controls, for ${left} at least.` : "Nobody controls: everybody only watches.");
    setText($("seat"), `${mine ? "you control" : name ? `${name} controls` : "nobody controls"} · ${state.viewers} ${state.viewers === 1 ? "viewer" : "viewers"}`);
    $("take").hidden = mine;
    $("take").disabled = Boolean(name);
    $("give").hidden = !mine;
    for (const button of document.querySelectorAll("[data-needs=control]")) button.disabled = !mine || !state.running;
    for (const row of $("quantities").children) {
      const value = state.running ? state.values[row.quantity.signal] : null;
      setText(row.querySelector(".now"), missing(value) ? "–" : `${number(value / row.quantity.scale)} ${row.quantity.unit}`);
    }
  };
  const who = () => $("who").value.trim() || "somebody";
  const SAID_MS = 8000;
  let fading = 0;
  const notify = (text, done) => {
    $("said").hidden = false;
    $("said").className = done ? "" : "bad";
    setText($("said"), text);
    clearTimeout(fading);
    if (done) fading = setTimeout(() => { $("said").hidden = true; }, SAID_MS);
  };

  let asking = null;
  const ask = (question, yes, meant, stop = false) => {
    if ($("ask").open) $("ask").close();
    asking = meant;
    $("question").textContent = question;
    $("preview").textContent = "";
    showCourses([]);
    $("yes").textContent = yes;
    $("yes").hidden = !yes;
    $("no").textContent = yes ? "No" : "Close";
    $("ask").className = stop ? "stop" : "";
    $("ask").showModal();
    $(stop ? "yes" : "no").focus();
  };
  const answer = (yes) => {
    const meant = asking;
    asking = null;
    $("ask").close();
    showCourses([]);
    if (yes && meant) meant();
  };
  // What is to come of a change: nine futures in ten lie in the band, half of them on either side of the line.
  let futures = [];
  const FUTURE_PX = [330, 140], FUTURE_LEAST = { N: 4, "N·m": 0.5 };
  const showFutures = (message) => {
    $("preview").textContent = message.text;
    showCourses(message.courses);
  };
  const showCourses = (courses) => {
    for (const u of futures) u.destroy();
    $("futures").replaceChildren();
    $("futures").hidden = !courses.length;
    futures = courses.map((course) => {
      const figure = make("figure"), at = make("div", "", "plot");
      figure.dataset.course = course.name;
      figure.append(make("h3", `${course.name} in ${course.unit}`), at);
      $("futures").append(figure);
      const edge = { width: 0, points: { show: false } }, numbered = { ...axis(11), values: ticks }, least = FUTURE_LEAST[course.unit];
      const u = new uPlot({
        width: FUTURE_PX[0], height: FUTURE_PX[1], padding: [8, 8, 0, 0], legend: { show: false }, cursor: { show: false },
        series: [{}, edge, edge, { width: 1.5, stroke: () => colour("--vermillion"), points: { show: false } }],
        bands: [{ series: [1, 2], fill: () => colour("--vermillion", 0.2) }],
        scales: { x: { time: false }, y: { range: (u, low, high) => height(low, high, null, WIDER, least) } },
        axes: [{ ...numbered, size: 26, values: (u, values) => values.map((v) => `+${v} s`) }, { ...numbered, size: AXIS_PX }],
        hooks: { draw: [(u) => { u.ctx.save(); u.ctx.beginPath(); u.ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height); u.ctx.clip(); markLevels(u, course.levels); u.ctx.restore(); }] },
      }, [course.t_s, course.high, course.low, course.median], at);
      return u;
    });
  };
  const stop = () => !isReplay && ask("Stop every device on the bus?", "STOP", () => {
    if (!request({ do: "stop", name: who() })) notify("EMERGENCY STOP NOT SENT: no connection to the server of this page. Stop at the machine, or with hilbench estop.", false);
  }, true);
  const isStopping = () => $("ask").open && $("ask").className === "stop";

  $("stop").addEventListener("click", stop);
  $("stop-there").addEventListener("click", stop); // a dialogue covers the other one
  $("yes").addEventListener("click", () => answer(true));
  $("no").addEventListener("click", () => answer(false));
  $("ask").addEventListener("cancel", () => { asking = null; });
  $("take").addEventListener("click", () => {
    if ($("who").value.trim()) request({ do: "take", name: who() });
    else { notify("Take control: expected your name, which others and the journal are told", false); $("who").focus(); }
  });
  $("give").addEventListener("click", () => request({ do: "give" }));
  $("pause").addEventListener("click", pause);
  $("who").value = localStorage.getItem("hilbench-name") ?? "";
  $("who").addEventListener("change", () => localStorage.setItem("hilbench-name", $("who").value.trim()));
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target === $("who")) return;
    const key = event.key.toLowerCase();
    if (key === "e") { // also in a field for a number, which has no exponent, as in the terminal
      event.preventDefault();
      if (isStopping()) answer(true); else stop();
    } else if ($("ask").open && key === "y") answer(true);
    else if ($("ask").open && key === "n") answer(false);
    else if (key === " " && event.target === document.body) { event.preventDefault(); pause(); }
  });
  addEventListener("resize", resize);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => plots.forEach((u) => u.redraw(true, true)));

  // -- connection ------------------------------------------------------------------------------------------

  const ANSWER_MS = 8000, STOP_ANSWER_MS = 1500, SILENCE_MS = 2000;
  let socket = null, again_ms = 250, numbers = 0, heardAt = 0;
  const waiting = new Map();
  const name = location.pathname.slice(isReplay ? "/replay/".length : 0), source = isReplay ? `played/${name}` : "live";
  const say = (message) => {
    if (!socket || socket.readyState !== WebSocket.OPEN) return false;
    socket.send(JSON.stringify(message));
    return true;
  };
  const request = (message, then = null) => {
    const number = ++numbers, isStop = message.do === "stop";
    if (!say({ ...message, number })) {
      if (!isStop) notify("Not sent: no connection to the server of this page", false);
      return false;
    }
    const late = setTimeout(() => notify(isStop ? "EMERGENCY STOP: no answer yet. Stop at the machine, or with hilbench estop." : "No answer yet", false), isStop ? STOP_ANSWER_MS : ANSWER_MS);
    waiting.set(number, { late, then });
    return true;
  };
  const take = (message) => {
    if (message.kind === "layout") {
      layout = message;
      generation = -1;
      sessionStorage.setItem("hilbench-viewer", layout.viewer);
      build();
    } else if (message.kind === "said") {
      const known = waiting.get(message.number);
      clearTimeout(known?.late);
      waiting.delete(message.number);
      if (known?.then) known.then(message); else notify(message.text, message.done);
    } else if (message.kind === "state") {
      state = message;
      if (message.generation !== generation && generation >= 0) $("ended").dataset.of = "";
      showEvents(message.events);
      showFigures();
      showMachine();
      showControl();
      showEnd();
      document.body.dataset.condition = state.condition;
    }
  };
  const connected = (is) => {
    $("lost").hidden = is;
    $("all").classList.toggle("old", !is);
    document.body.dataset.connection = is ? "open" : "lost";
  };
  const connect = () => {
    socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/${source}`);
    socket.binaryType = "arraybuffer";
    socket.addEventListener("open", () => {
      again_ms = 250;
      socket.send(JSON.stringify({ viewer: sessionStorage.getItem("hilbench-viewer") }));
    });
    socket.addEventListener("message", (event) => {
      heardAt = performance.now();
      connected(true);
      if (typeof event.data === "string") take(JSON.parse(event.data)); else if (layout) takeStretches(event.data);
    });
    socket.addEventListener("close", async (event) => {
      connected(false);
      if (event.reason) {
        $("refused").hidden = false;
        $("refused").textContent = event.reason;
        return;
      }
      // A server that was started anew has another token, and prints another address.
      const known = await fetch("/session").catch(() => null);
      $("refused").hidden = known === null || known.ok;
      setTimeout(connect, again_ms);
      again_ms = Math.min(2 * again_ms, 4000);
    });
  };
  setInterval(() => { if (performance.now() - heardAt > SILENCE_MS) connected(false); }, 500);
  connect();
  requestAnimationFrame(beat);
});
