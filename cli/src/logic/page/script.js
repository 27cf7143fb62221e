"use strict";
(() => {
  const plots = [...document.querySelectorAll("svg.plot")];
  const measured = plots.find((plot) => plot.dataset.end);
  if (!measured) return;
  const left = Number(measured.dataset.left), right = Number(measured.dataset.right), end = Number(measured.dataset.end);
  const cursors = document.querySelectorAll("line.cursor");
  const phases = [...document.querySelectorAll(".phase")];
  const box = document.getElementById("cursor");
  let at = null;

  // The points of every curve, in the units of its picture: what is drawn is what is read out.
  const curves = plots.flatMap((plot) => {
    const outputs = plot.parentElement.querySelectorAll("output");
    return [...plot.querySelectorAll(".curve")].map((curve, index) => ({
      output: outputs[index],
      top: Number(plot.dataset.top),
      per: Number(plot.dataset.per),
      runs: [...curve.querySelectorAll("polyline")].map((line) =>
        line.getAttribute("points").split(" ").map((point) => point.split(",").map(Number))),
    }));
  });

  function value(curve, x) {
    for (const run of curve.runs) {
      if (x < run[0][0] - 1 || x > run[run.length - 1][0] + 1) continue;
      let low = 0, high = run.length - 1;
      while (low < high) {
        const middle = (low + high) >> 1;
        if (run[middle][0] < x) low = middle + 1; else high = middle;
      }
      return curve.top - run[low][1] * curve.per;
    }
    return null;
  }

  function show(x) {
    at = Math.min(Math.max(x, left), right);
    const time = (at - left) / (right - left) * end;
    for (const line of cursors) {
      line.setAttribute("x1", at);
      line.setAttribute("x2", at);
      line.setAttribute("visibility", "visible");
    }
    for (const curve of curves) {
      const read = value(curve, at);
      curve.output.textContent = read === null ? "–" : read.toPrecision(3).replace(/e.*/, "");
      if (read !== null && Math.abs(read) >= 1000) curve.output.textContent = read.toFixed(0);
      if (read !== null && Math.abs(read) < 0.001) curve.output.textContent = "0";
    }
    const phase = phases.find((one) => Number(one.dataset.begin) <= time && time <= Number(one.dataset.end));
    document.getElementById("cursor-time").textContent = time.toFixed(2) + " s";
    document.getElementById("cursor-phase").textContent = phase ? phase.dataset.name : "";
    box.hidden = false;
  }

  function hide() {
    at = null;
    for (const line of cursors) line.setAttribute("visibility", "hidden");
    for (const curve of curves) curve.output.textContent = "";
    box.hidden = true;
  }

  for (const plot of plots) {
    plot.addEventListener("pointermove", (event) => {
      const bounds = plot.getBoundingClientRect();
      show((event.clientX - bounds.left) / bounds.width * plot.viewBox.baseVal.width);
    });
    plot.addEventListener("pointerleave", hide);
  }
  document.addEventListener("keydown", (event) => {
    if (event.key === "Escape") hide();
    if (event.key !== "ArrowLeft" && event.key !== "ArrowRight") return;
    const step = (event.shiftKey ? 20 : 2) * (event.key === "ArrowLeft" ? -1 : 1);
    show((at === null ? left : at) + step);
  });
})();
