// Starts the page: data into textures, controls into state, state into pictures. Draws only when something changed.
const NARROW = 0.9;

function start() {
  const canvas = byId("canvas");
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
  renderer.autoClear = false;
  renderer.setPixelRatio(Math.min(2, window.devicePixelRatio));
  // three.js only writes to the console when a shader does not compile.
  renderer.debug.onShaderError = (gl, _program, vertex, fragment) => {
    throw new Error([vertex, fragment].map((shader) => gl.getShaderInfoLog(shader)).join("\n"));
  };
  const data = readData();
  const needed = Math.max(TEXTURE_WIDTH, Math.ceil(Math.max(data.manifest.faces, data.manifest.vertices) / TEXTURE_WIDTH));
  if (needed > renderer.capabilities.maxTextureSize) throw new Error("this graphics card is too small for these meshes");
  const surface = new Surface(data);
  let isAsked = false;
  const ask = () => {
    if (!isAsked) requestAnimationFrame(draw);
    isAsked = true;
  };
  const controls = new Controls(data.layers, (isOtherView) => {
    if (isOtherView && !view.isMoved) view.reset(aspect());
    ask();
  });
  const view = new View(canvas, data.positions, ask);

  const isTall = () => canvas.clientWidth < NARROW * canvas.clientHeight;
  const panes = () => panesOf(controls.state, isTall());
  const aspect = () => {
    const [{ width, height }] = panes();
    return (width * canvas.clientWidth) / Math.max(1, height * canvas.clientHeight);
  };
  const reset = () => view.reset(aspect());

  function draw() {
    isAsked = false;
    document.documentElement.toggleAttribute("data-tall", isTall());
    surface.colorBy(controls.state.layer, controls.scaleEnd);
    surface.setWires(controls.state.wires);
    view.clipToMesh();
    drawPanes(renderer, surface, view.camera, panes());
    const root = document.documentElement.dataset;
    root.frames = Number(root.frames || 0) + 1;
    root.state = "ready";
  }

  function resize() {
    renderer.setSize(canvas.clientWidth, canvas.clientHeight, false);
    if (!view.isMoved) reset();
    ask();
  }

  const turns = { ArrowLeft: [-TURN, 0], ArrowRight: [TURN, 0], ArrowUp: [0, TURN], ArrowDown: [0, -TURN] };
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (turns[event.key]) view.turn(...turns[event.key]);
    else if (event.key === "+" || event.key === "=") view.zoom(1 / 1.15);
    else if (event.key === "-") view.zoom(1.15);
    else if (event.key === "0") reset();
    else if (!controls.press(event.key)) return;
    event.preventDefault();
  });
  byId("reset").addEventListener("click", reset);
  byId("up").addEventListener("change", (event) => {
    view.setUp(event.target.value);
    reset();
  });
  new ResizeObserver(resize).observe(byId("stage"));
  resize();
}

/** Tells of what went wrong where the view would be; the figures beside it stand. */
function fail(error) {
  document.documentElement.dataset.state = "failed";
  byId("trouble").hidden = false;
  byId("trouble").textContent = `The 3D view cannot be shown: ${error.message}. It needs a browser with WebGL 2.`;
}

window.addEventListener("error", (event) => fail(event.error || event));
try {
  start();
} catch (error) {
  fail(error);
  throw error;
}
