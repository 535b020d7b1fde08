// Buttons, slider, keys and legend: they read and write one state, and `changed` tells what drew before to draw anew.
const byId = (id) => document.getElementById(id);
const VIEWS = ["side", "wipe", "blend"];
const TURN = 6;
const STEP = 0.05;
const UNITS = { "°": "degrees", edges: "mean edges", "%": "percent" };

/** A number in a few digits, without needless zeros. */
function inWords(value) {
  return String(Number(value.toPrecision(3)));
}

class Controls {
  constructor(layers, changed) {
    this.layers = layers;
    this.changed = changed;
    this.state = { view: "side", slider: 0.5, layer: null, wires: false };
    this.scaleEnds = new Map(layers.map((layer) => [layer.name, layer.scaleEnd]));
    byId("ramp").style.background = colorGradient();
    this.listen();
    this.show();
  }

  listen() {
    for (const radio of document.querySelectorAll("input[name=view]")) {
      radio.addEventListener("change", () => this.setView(radio.value));
    }
    byId("slider").addEventListener("input", (event) => this.setSlider(Number(event.target.value)));
    byId("layer").addEventListener("change", (event) => this.setLayer(event.target.value));
    byId("wires").addEventListener("change", (event) => this.setWires(event.target.checked));
    byId("scale-end").addEventListener("change", (event) => this.setScaleEnd(Number(event.target.value)));
    const divider = byId("divider");
    divider.addEventListener("pointerdown", (event) => divider.setPointerCapture(event.pointerId));
    divider.addEventListener("pointermove", (event) => {
      if (!divider.hasPointerCapture(event.pointerId)) return;
      const stage = byId("stage").getBoundingClientRect();
      this.setSlider((event.clientX - stage.left) / stage.width);
    });
  }

  get scaleEnd() {
    return this.state.layer ? this.scaleEnds.get(this.state.layer.name) : 1;
  }

  setView(view) {
    this.update({ view });
  }

  setSlider(slider) {
    this.update({ slider: Math.min(1, Math.max(0, slider)) });
  }

  setLayer(name) {
    this.update({ layer: this.layers.find((layer) => layer.name === name) || null });
  }

  setWires(wires) {
    this.update({ wires });
  }

  setScaleEnd(value) {
    if (this.state.layer && value > 0) this.scaleEnds.set(this.state.layer.name, value);
    this.update({});
  }

  /** What a key does to the state; false where it means nothing here. */
  press(key) {
    const { slider, layer, wires, view } = this.state;
    if (VIEWS[Number(key) - 1]) this.setView(VIEWS[Number(key) - 1]);
    else if (key === "w") this.setWires(!wires);
    else if (key === "c") this.setLayer(["", ...this.layers.map((own) => own.name), ""][this.layers.indexOf(layer) + 2]);
    else if ((key === "," || key === ".") && view !== "side") this.setSlider(slider + (key === "," ? -STEP : STEP));
    else return false;
    return true;
  }

  update(changes) {
    const isOtherView = changes.view !== undefined && changes.view !== this.state.view;
    Object.assign(this.state, changes);
    this.show();
    this.changed(isOtherView);
  }

  /** Brings every element in line with the state. */
  show() {
    const { view, slider, layer, wires } = this.state;
    document.documentElement.dataset.view = view;
    document.querySelector(`input[name=view][value=${view}]`).checked = true;
    byId("layer").value = layer ? layer.name : "";
    byId("wires").checked = wires;
    byId("slider-field").hidden = view === "side";
    byId("divider").hidden = view !== "wipe";
    byId("divider").style.left = `${100 * slider}%`;
    byId("slider").value = slider;
    const percent = Math.round(100 * slider);
    const text = view === "wipe" ? `${percent} % of the width shows before` : `${percent} % of the way to after`;
    byId("slider").setAttribute("aria-valuetext", text);
    byId("slider-left").textContent = view === "wipe" ? "all after" : "before";
    byId("slider-right").textContent = view === "wipe" ? "all before" : "after";
    byId("tag-before").hidden = view === "wipe" && slider < 0.02;
    byId("tag-after").hidden = view === "wipe" && slider > 0.98;
    this.showLegend();
  }

  showLegend() {
    const { layer } = this.state;
    byId("legend").hidden = byId("scale-field").hidden = layer === null;
    if (!layer) return;
    const end = this.scaleEnd;
    const unit = layer.unit.length === 1 ? layer.unit : "";
    const numbers = [0, 0.25, 0.5, 0.75, 1].map((part) => inWords(part * end));
    if (layer.top > end * 1.000001) numbers[4] = `≥ ${numbers[4]}`;
    byId("scale-end").value = Number(end.toPrecision(6));
    byId("scale-unit").textContent = layer.unit.trim();
    byId("legend-title").textContent = `${layer.label}, ${UNITS[layer.unit.trim()]}`;
    byId("ramp").setAttribute("aria-label", `colour scale from 0 to ${inWords(end)}${layer.unit}`);
    byId("ticks").replaceChildren(
      ...numbers.map((number) => Object.assign(document.createElement("li"), { textContent: number + unit })),
    );
    byId("no-value").hidden = !layer.hasUnknown;
  }
}
