"use strict";
(() => {
  const SVG = "http://www.w3.org/2000/svg";
  const data = JSON.parse(document.getElementById("data").textContent);
  const byId = (id) => document.getElementById(id);
  const table = byId("pairs");
  const headings = [...table.tHead.rows[0].cells];
  const someWithout = data.pairs.some((pair) => !pair.F);
  const stage = byId("stage");

  // Everything that the page shows follows from this and from the data; it is kept in the address.
  const state = { method: 0, pair: null, sort: "pair", order: "ascending", match: null, point: null };

  // --- the table -------------------------------------------------------------------------------

  const result = (index) => data.results[state.method][index];

  // null stands for infinite: a pair without a pose.
  function value(index, key) {
    if (key === "pair") return index;
    const owner = key in data.pairs[index] ? data.pairs[index] : result(index);
    return owner[key];
  }

  function compare(first, second) {
    if (typeof first === "string") return first.localeCompare(second);
    return (first === null ? Infinity : first) < (second === null ? Infinity : second) ? -1
      : first === second ? 0 : 1;
  }

  function sorted() {
    const sign = state.order === "descending" ? -1 : 1;
    return data.pairs.map((_, index) => index).sort((first, second) =>
      sign * compare(value(first, state.sort), value(second, state.sort)) || first - second);
  }

  function cellText(index, heading) {
    const { key, decimals } = heading.dataset;
    if (key === "pair") return data.pairs[index].name + (someWithout && data.pairs[index].F ? " ●" : "");
    const shown = value(index, key);
    if (typeof shown !== "number") return shown === null ? "–" : shown;
    return shown.toFixed(Number(decimals));
  }

  function drawTable() {
    const rows = sorted().map((index) => {
      const row = document.createElement("tr");
      row.dataset.index = index;
      row.tabIndex = 0;
      row.classList.toggle("failed", !result(index).success);
      row.classList.toggle("selected", index === state.pair);
      for (const heading of headings) row.insertCell().textContent = cellText(index, heading);
      return row;
    });
    table.tBodies[0].replaceChildren(...rows);
    for (const heading of headings) {
      if (heading.dataset.key === state.sort) heading.setAttribute("aria-sort", state.order);
      else heading.removeAttribute("aria-sort");
    }
    byId("method").value = state.method;
  }

  function markRow() {
    for (const row of table.tBodies[0].rows) {
      row.classList.toggle("selected", Number(row.dataset.index) === state.pair);
    }
  }

  // --- geometry: pixels of the images that the methods saw, (0, 0) the centre of the first ------

  // The line a x + b y + c = 0 in the other image of a point in image `from` (1 or 2).
  function epipolarLine(F, from, [x, y]) {
    const at = (row, column) => (from === 1 ? F[3 * row + column] : F[3 * column + row]);
    return [0, 1, 2].map((row) => at(row, 0) * x + at(row, 1) * y + at(row, 2));
  }

  // The part of a line within an image, as two points; null where it misses the image.
  function clip([a, b, c], { width, height }) {
    const [left, top, right, bottom] = [-0.5, -0.5, width - 0.5, height - 0.5];
    const ends = [];
    if (b !== 0) for (const x of [left, right]) ends.push([x, -(a * x + c) / b]);
    if (a !== 0) for (const y of [top, bottom]) ends.push([-(b * y + c) / a, y]);
    const slack = 1e-6 * (width + height);
    const inside = ends.filter(([x, y]) =>
      x >= left - slack && x <= right + slack && y >= top - slack && y <= bottom + slack);
    let longest = null;
    for (const one of inside) {
      for (const other of inside) {
        const length = Math.hypot(one[0] - other[0], one[1] - other[1]);
        if (length > (longest ? longest.length : slack)) longest = { length, ends: [one, other] };
      }
    }
    return longest && longest.ends;
  }

  function distanceToLine([x, y], [a, b, c]) {
    return Math.abs(a * x + b * y + c) / Math.hypot(a, b);
  }

  // D_e: the mean of both points' distances to the other's epipolar line.
  function epipolarDistance(F, [point1, point2]) {
    return (distanceToLine(point2, epipolarLine(F, 1, point1))
      + distanceToLine(point1, epipolarLine(F, 2, point2))) / 2;
  }

  // --- the pair ---------------------------------------------------------------------------------

  // Image 2 stands to the right of image 1, at its height; lengths are pixels of image 1.
  function arrange(pair) {
    const [one, two] = [data.images[pair.image1], data.images[pair.image2]];
    const scale = one.height / two.height;
    const left = 1.02 * one.width;
    return {
      images: [one, two],
      size: [left + scale * two.width, one.height],
      onto: (number, [x, y]) => (number === 1 ? [x + 0.5, y + 0.5]
        : [left + (x + 0.5) * scale, (y + 0.5) * scale]),
      // The image number and the point in it; null between the images.
      from: ([x, y]) => {
        const [number, point] = x < left ? [1, [x - 0.5, y - 0.5]]
          : [2, [(x - left) / scale - 0.5, y / scale - 0.5]];
        const { width, height } = number === 1 ? one : two;
        const within = point[0] >= -0.5 && point[1] >= -0.5
          && point[0] <= width - 0.5 && point[1] <= height - 0.5;
        return within ? [number, point] : null;
      },
    };
  }

  function matchesOf(index) {
    const flat = result(index).sample || [];
    const matches = [];
    for (let i = 0; i < flat.length; i += 5) {
      const [x1, y1, x2, y2] = flat.slice(i, i + 4).map((tenths) => tenths / 10);
      matches.push({ points: [[x1, y1], [x2, y2]], inlier: flat[i + 4] === 1 });
    }
    return matches;
  }

  function element(name, attributes, parent) {
    const made = document.createElementNS(SVG, name);
    for (const [key, one] of Object.entries(attributes)) made.setAttribute(key, one);
    if (parent) parent.append(made);
    return made;
  }

  function drawLine([x1, y1], [x2, y2], parent, attributes = {}) {
    return element("line", { x1, y1, x2, y2, ...attributes }, parent);
  }

  function drawPair() {
    stage.replaceChildren();
    stage.removeAttribute("viewBox");
    byId("match-counts").textContent = byId("pair-result").textContent = "";
    byId("pair-name").textContent = "No pair chosen";
    if (state.pair === null) return drawSelection(null);
    const pair = data.pairs[state.pair];
    byId("pair-name").textContent =
      `${pair.name}: ${pair.rotation.toFixed(1)}° and ${pair.baseline.toFixed(0)} mm apart`;
    byId("pair-result").textContent = resultText();
    if (!pair.F) {
      byId("selection").textContent = "This page has no pictures of this pair.";
      return;
    }
    const layout = arrange(pair);
    stage.setAttribute("viewBox", `0 0 ${layout.size.join(" ")}`);
    layout.images.forEach((image, i) => {
      const [x, y] = layout.onto(i + 1, [-0.5, -0.5]);
      const [right, bottom] = layout.onto(i + 1, [image.width - 0.5, image.height - 0.5]);
      element("image", {
        href: image.source, x, y, width: right - x, height: bottom - y, preserveAspectRatio: "none",
      }, stage);
    });
    const matches = matchesOf(state.pair);
    const group = element("g", { id: "matches" }, stage);
    matches.forEach((match, index) => drawMatch(match, index, layout, group));
    element("g", { id: "lines" }, stage);
    const inliers = matches.filter((match) => match.inlier).length;
    byId("match-counts").textContent =
      `${inliers} inliers and ${matches.length - inliers} outliers of a sample`;
    drawSelection(layout);
  }

  function resultText() {
    const own = result(state.pair);
    const counts = `${own.inliers} of ${own.matches} matches are inliers`;
    const name = data.methods[state.method];
    if (!own.success) return `${name}: no pose (${own.status}), ${counts}`;
    return `${name}: R off ${own.R.toFixed(2)}°, t off ${own.t.toFixed(2)}°, ${counts}`;
  }

  function drawMatch(match, index, layout, parent) {
    const shown = byId(match.inlier ? "show-inliers" : "show-outliers").checked;
    if (!shown) return;
    const kind = match.inlier ? "inlier" : "outlier";
    const group = element("g", { class: `match ${kind}`, "data-index": index }, parent);
    const ends = match.points.map((point, i) => layout.onto(i + 1, point));
    drawLine(...ends, group);
    for (const [cx, cy] of ends) element("circle", { cx, cy, r: layout.size[1] / 110 }, group);
  }

  // The true epipolar lines of the chosen match, or of one that the pointer is over, or of a point.
  function drawSelection(layout, hovered = null) {
    const note = byId("selection");
    note.textContent = "Click a match or a point in either image for its true epipolar line.";
    if (!layout) return;
    const group = byId("lines");
    group.replaceChildren();
    const pair = data.pairs[state.pair];
    const number = hovered === null ? state.match : hovered;
    for (const one of stage.querySelectorAll(".match")) {
      one.classList.toggle("chosen", Number(one.dataset.index) === number);
    }
    const match = number === null ? null : matchesOf(state.pair)[number];
    if (match) {
      match.points.forEach((point, i) => drawEpipolar(pair.F, i + 1, point, layout, group));
      const distance = epipolarDistance(pair.F, match.points).toFixed(2);
      note.textContent = `Match ${number}: ${match.inlier ? "an inlier" : "an outlier"}, `
        + `${distance} px from the true epipolar lines.`;
    } else if (state.point) {
      const [from, point] = state.point;
      const met = drawEpipolar(pair.F, from, point, layout, group);
      note.textContent = `Point (${point.map((one) => one.toFixed(1)).join(", ")}) of image ${from}: `
        + (met ? `its true epipolar line in image ${3 - from}.`
          : `its true epipolar line passes image ${3 - from} by.`);
    }
  }

  function drawEpipolar(F, from, point, layout, parent) {
    const [cx, cy] = layout.onto(from, point);
    const ends = clip(epipolarLine(F, from, point), layout.images[2 - from]);
    if (ends) {
      const [start, end] = ends.map((one) => layout.onto(3 - from, one));
      drawLine(start, end, parent, { class: "epipolar", "data-image": 3 - from });
    }
    element("circle", { cx, cy, r: layout.size[1] / 90, class: "point", "data-image": from }, parent);
    return ends !== null;
  }

  const currentLayout = () => {
    const pair = state.pair === null ? null : data.pairs[state.pair];
    return pair && pair.F ? arrange(pair) : null;
  };

  // --- the address ------------------------------------------------------------------------------

  function remember() {
    const parts = new URLSearchParams({
      method: data.methods[state.method], sort: state.sort, order: state.order,
    });
    if (state.pair !== null) parts.set("pair", data.pairs[state.pair].name);
    if (state.match !== null) parts.set("match", state.match);
    if (state.point) parts.set("point", state.point.flat().map((one) => +one.toFixed(2)).join(","));
    history.replaceState(null, "", `#${parts}`);
  }

  // What cannot be understood is ignored.
  function recall() {
    const parts = new URLSearchParams(location.hash.slice(1));
    state.method = Math.max(0, data.methods.indexOf(parts.get("method")));
    const keys = headings.map((heading) => heading.dataset.key);
    state.sort = keys.includes(parts.get("sort")) ? parts.get("sort") : "pair";
    state.order = parts.get("order") === "descending" ? "descending" : "ascending";
    const index = data.pairs.findIndex((pair) => pair.name === parts.get("pair"));
    state.pair = index < 0 ? null : index;
    state.match = /^\d+$/.test(parts.get("match") || "") ? Number(parts.get("match")) : null;
    const [from, ...point] = (parts.get("point") || "").split(",").map(Number);
    const valid = [1, 2].includes(from) && point.length === 2 && point.every(Number.isFinite);
    state.point = valid ? [from, point] : null;
    drawTable();
    drawPair();
  }

  // --- what the user does -----------------------------------------------------------------------

  function choosePair(index) {
    if (index !== state.pair) Object.assign(state, { pair: index, match: null, point: null });
    markRow();
    drawPair();
    remember();
  }

  table.tHead.addEventListener("click", (event) => {
    const heading = event.target.closest("th");
    if (!heading) return;
    const again = heading.dataset.key === state.sort && state.order === "ascending";
    state.order = again ? "descending" : "ascending";
    state.sort = heading.dataset.key;
    drawTable();
    remember();
  });

  table.tBodies[0].addEventListener("click", (event) => {
    const row = event.target.closest("tr");
    if (row) choosePair(Number(row.dataset.index));
  });

  table.tBodies[0].addEventListener("keydown", (event) => {
    const row = event.target.closest("tr");
    const step = { ArrowDown: "nextElementSibling", ArrowUp: "previousElementSibling" }[event.key];
    const chosen = step && row ? row[step] : event.key === "Enter" ? row : null;
    if (!chosen) return;
    event.preventDefault();
    chosen.focus();
    choosePair(Number(chosen.dataset.index));
  });

  byId("method").addEventListener("change", (event) => {
    Object.assign(state, { method: Number(event.target.value), match: null });
    drawTable();
    drawPair();
    remember();
  });

  for (const id of ["show-inliers", "show-outliers"]) byId(id).addEventListener("change", drawPair);

  stage.addEventListener("click", (event) => {
    const layout = currentLayout();
    if (!layout) return;
    const match = event.target.closest(".match");
    if (match) {
      Object.assign(state, { match: Number(match.dataset.index), point: null });
    } else {
      const at = new DOMPoint(event.clientX, event.clientY)
        .matrixTransform(stage.getScreenCTM().inverse());
      Object.assign(state, { match: null, point: layout.from([at.x, at.y]) });
    }
    drawSelection(layout);
    remember();
  });

  stage.addEventListener("pointerover", (event) => {
    const match = event.target.closest(".match");
    if (match) drawSelection(currentLayout(), Number(match.dataset.index));
  });

  stage.addEventListener("pointerout", (event) => {
    if (event.target.closest(".match")) drawSelection(currentLayout());
  });

  window.addEventListener("hashchange", recall);
  recall();
})();
