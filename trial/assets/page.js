// Draws the plots of a page from its data, and moves plots of one group together.
// The rule of this file: nothing leaves the page and nothing comes from elsewhere.
"use strict";
(() => {
  const page = JSON.parse(document.getElementById("page-data").textContent);
  const INK = "#1d2430", SOFT = "#5b6675", GRID = "#e6eaef";
  const FONT = '12px system-ui, -apple-system, "Segoe UI", Roboto, "DejaVu Sans", sans-serif';
  const arrays = new Map(), groups = new Map();

  // Base64 of little-endian float32 or float64; where a value is unknown (NaN) uPlot wants null.
  function array(number) {
    if (!arrays.has(number)) {
      const { type, data } = page.arrays[number];
      const text = atob(data), bytes = new Uint8Array(text.length);
      for (let at = 0; at < text.length; at++) bytes[at] = text.charCodeAt(at);
      const values = type === "f8" ? new Float64Array(bytes.buffer) : new Float32Array(bytes.buffer);
      arrays.set(number, values.some(Number.isNaN) ? Array.from(values, v => (Number.isNaN(v) ? null : v)) : values);
    }
    return arrays.get(number);
  }

  function shown(value, digits = 6) {
    if (value == null) return "–";
    const size = Math.abs(value);
    if (size !== 0 && (size < 1e-4 || size >= 1e6)) return value.toExponential(3).replace("-", "−");
    const [whole, part] = String(Number(value.toPrecision(digits))).replace("-", "−").split(".");
    return (whole.length > 4 ? whole.replace(/\B(?=(\d{3})+$)/g, "\u202f") : whole) + (part ? `.${part}` : "");
  }

  // One entry a label; several series of one label (gait cycles) are shown and hidden together.
  function legend(plot, host) {
    const entries = [];
    plot.series.forEach((series, place) => {
      const known = entries.find(entry => entry.label === series.label);
      if (known) known.places.push(...series.places);
      else entries.push({ ...series, places: [...series.places], place });
    });
    for (const entry of entries) {
      const button = document.createElement("button"), output = document.createElement("output");
      const dash = entry.dash ? 'stroke-dasharray="5 3"' : "";
      button.type = "button";
      button.setAttribute("aria-pressed", "true");
      button.title = entry.tip ? `${entry.tip}; show or hide` : "show or hide";
      button.innerHTML = `<svg width="22" height="10"><path d="M0 5H22" stroke="${entry.colour}" stroke-width="2.5" ${dash}/></svg>`;
      button.append(entry.label, output);
      button.onclick = () => {
        const show = button.getAttribute("aria-pressed") === "false";
        button.setAttribute("aria-pressed", String(show));
        plot.chart.batch(() => entry.places.forEach(place => plot.chart.setSeries(place, { show })));
      };
      entry.output = output;
      host.append(button);
    }
    const place = document.createElement("output");
    host.append(place);
    return chart => {
      const at = chart.cursor.idx;
      for (const { places, output } of entries) {
        const values = at == null ? [] : places.map(place => chart.data[place][at]).filter(value => value != null);
        const low = Math.min(...values), high = Math.max(...values);
        output.textContent = values.length === 0 ? "" : low === high ? shown(low, 4) : `${shown(low, 4)} … ${shown(high, 4)}`;
      }
      place.textContent = at == null ? "" : `at ${shown(chart.data[0][at])}`;
    };
  }

  function columns(plot) {
    const data = [array(plot.x)], series = [{}], bands = [];
    for (const line of plot.series) {
      const drawn = { label: line.label, stroke: line.colour, width: line.width, dash: line.dash ? [6, 4] : undefined,
        points: { show: line.points, size: 7, fill: line.colour } };
      if (line.steps) drawn.paths = uPlot.paths.stepped({ align: 1 });
      if (line.points) drawn.paths = () => null;
      line.places = [data.length];
      data.push(array(line.y));
      series.push(drawn);
      if (line.high != null) {
        line.places.push(data.length);
        bands.push({ series: [data.length, data.length - 1], fill: line.colour + "33" });
        data.push(array(line.high));
        series.push({ ...drawn });
      }
    }
    return { data, series, bands };
  }

  function marks(plot) {
    return chart => {
      const { ctx, bbox } = chart, ratio = devicePixelRatio;
      ctx.save();
      ctx.strokeStyle = ctx.fillStyle = "#8a5a00";
      ctx.lineWidth = ratio;
      ctx.setLineDash([3 * ratio, 3 * ratio]);
      for (const at of plot.marks) {
        const x = chart.valToPos(at, "x", true);
        if (x < bbox.left || x > bbox.left + bbox.width) continue;
        ctx.beginPath();
        ctx.moveTo(x, bbox.top);
        ctx.lineTo(x, bbox.top + bbox.height);
        ctx.stroke();
      }
      ctx.restore();
    };
  }

  // A group shares one window of x; `full` is what all its plots span together.
  function group(plot) {
    const name = plot.linked ?? `alone ${plot.id}`;
    if (!groups.has(name)) groups.set(name, { charts: [], full: [Infinity, -Infinity], label: plot.x_label, moving: false,
      linked: plot.linked != null });
    const found = groups.get(name), x = array(plot.x);
    found.full[0] = Math.min(found.full[0], x[0]);
    found.full[1] = Math.max(found.full[1], x[x.length - 1]);
    return found;
  }

  function move(found, min, max) {
    if (found.moving) return;
    found.moving = true;
    for (const chart of found.charts)
      if (chart.scales.x.min !== min || chart.scales.x.max !== max) chart.setScale("x", { min, max });
    found.moving = false;
    if (found.linked) tell(found, min, max);
  }

  const bar = document.querySelector(".window");
  function tell(found, min, max) {
    bar.hidden = min <= found.full[0] && max >= found.full[1];
    bar.querySelector("span").textContent = `${found.label}: ${shown(min)} … ${shown(max)}`;
    bar.querySelector("button").onclick = () => move(found, ...found.full);
  }

  function draw(plot, host) {
    const found = plot.group, { data, series, bands } = columns(plot);
    const read = legend(plot, host.previousElementSibling);
    const options = {
      width: host.clientWidth, height: plot.height, series, bands, legend: { show: false },
      scales: { x: { time: false }, y: { range } },
      axes: axes(plot, whole(data[0])),
      cursor: {
        drag: { x: true, y: false, dist: 4 },
        points: { size: 6 },
        bind: { dblclick: () => () => move(found, ...found.full) },
        sync: { key: plot.linked ?? `alone ${plot.id}`, setSeries: false,
          filters: { pub: type => type === "mousemove" || type === "mouseleave" } },
      },
      hooks: {
        setScale: [(chart, scale) => {
          if (scale === "x" && found.charts.includes(chart)) move(found, chart.scales.x.min, chart.scales.x.max);
        }],
        setCursor: [read],
        drawClear: [marks(plot)],
      },
    };
    plot.chart = new uPlot(options, data, host);
    plot.chart.setScale("x", { min: found.full[0], max: found.full[1] });
    found.charts.push(plot.chart);
    new ResizeObserver(() => plot.chart.setSize({ width: host.clientWidth, height: plot.height })).observe(host);
  }

  // A loop, such as force over position: its points joined in their order, both axes zoomed by dragging.
  function drawLoop(plot, host) {
    const facets = [{ scale: "x", auto: true }, { scale: "y", auto: true }];
    const paths = (chart, place) => uPlot.orient(chart, place, (series, xs, ys, scaleX, scaleY, toX, toY, left, top, wide, high) => {
      const stroke = new Path2D();
      let pen = "moveTo";
      for (let at = 0; at < xs.length; at++) {
        const unknown = xs[at] == null || ys[at] == null;
        if (!unknown) stroke[pen](toX(xs[at], scaleX, wide, left), toY(ys[at], scaleY, high, top));
        pen = unknown ? "moveTo" : "lineTo";
      }
      return { stroke, fill: null, clip: null, band: null, gaps: null, flags: 0 };
    });
    plot.series.forEach((line, place) => { line.places = [place + 1]; });
    legend(plot, host.previousElementSibling);
    const lines = plot.series.map(line => ({ label: line.label, stroke: line.colour, width: line.width,
      dash: line.dash ? [6, 4] : undefined, points: { show: false }, facets, paths }));
    plot.chart = new uPlot({
      mode: 2, width: host.clientWidth, height: plot.height, series: [{}, ...lines], legend: { show: false },
      scales: { x: { time: false, range }, y: { range } }, axes: axes(plot),
      cursor: { drag: { x: true, y: true, dist: 4 }, points: { show: false } },
    }, [null, ...plot.series.map(line => [array(line.x ?? plot.x), array(line.y)])], host);
    new ResizeObserver(() => plot.chart.setSize({ width: host.clientWidth, height: plot.height })).observe(host);
  }

  function axes(plot, incrs) {
    const axis = { stroke: SOFT, font: FONT, labelFont: FONT, labelSize: 20, grid: { stroke: GRID, width: 1 },
      ticks: { stroke: GRID, width: 1 } };
    const values = (chart, ticks) => ticks.map(tick => shown(tick));
    return [{ ...axis, label: plot.x_label, values, size: 34, incrs }, { ...axis, label: plot.y_label, values, size: 60 }];
  }

  for (const plot of page.plots) if (!plot.loop) plot.group = group(plot);
  for (const { full } of groups.values()) if (full[0] === full[1]) { full[0] -= 0.5; full[1] += 0.5; }
  const whole = x => x.every(Number.isInteger) ? [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000] : undefined;
  const range = (chart, min, max) => min === max ? [min - 0.5, max + 0.5] : uPlot.rangeNum(min, max, 0.1, true);
  for (const plot of page.plots) (plot.loop ? drawLoop : draw)(plot, document.getElementById(plot.id));
  document.documentElement.dataset.drawn = String(page.plots.length);
  globalThis.bowden = { groups, move, page };
})();
