// Figures of a report: drawn with plotly, in the colours of the page's scheme, again when the scheme changes.
const ahnnFigures = (() => {
  const all = [];
  const config = {responsive: true, displaylogo: false, showSendToCloud: false, plotlyServerURL: "",
                  modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"],
                  // on a phone the bar would cover the labels; drags and pinches work without it
                  displayModeBar: window.matchMedia("(max-width: 40rem)").matches ? false : "hover"};
  const scheme = window.matchMedia("(prefers-color-scheme: dark)");
  const paint = (figure, dark) => {
    const ink = dark ? "#e6e6e6" : "#1a1a1a", grid = dark ? "#3d3d3d" : "#dedede";
    for (const trace of figure.data) {
      if (trace.meta !== "ink") continue;
      for (const part of [trace.line, trace.marker, trace.error_y]) if (part) part.color = ink;
    }
    const axes = [figure.layout, figure.layout.scene || {}].flatMap(
      (part) => Object.keys(part).filter((key) => /^[xyz]axis/.test(key)).map((key) => part[key]));
    for (const axis of axes) Object.assign(axis, {gridcolor: grid, linecolor: grid, zerolinecolor: grid});
    figure.layout.font.color = ink;
    figure.layout.legend.font = {size: 12, color: ink};
    figure.layout.hoverlabel = {bgcolor: dark ? "#222" : "#fff", font: {color: ink}};
  };
  const draw = (entry, dark) => {
    paint(entry.figure, dark);
    return Plotly.react(entry.id, entry.figure.data, entry.figure.layout, config);
  };
  const redraw = (dark) => all.forEach((entry) => draw(entry, dark));
  scheme.addEventListener("change", (event) => redraw(event.matches));
  window.addEventListener("beforeprint", () => redraw(false));
  window.addEventListener("afterprint", () => redraw(scheme.matches));
  return {add: (id, figure) => { all.push({id, figure}); draw(all[all.length - 1], scheme.matches); }};
})();
