// The mesh as the graphics card sees it, and drawing it once or twice into one canvas.

/** The one mesh of the scene; `show` sets what the next drawing looks like. */
class Surface {
  constructor(data) {
    const colors = new THREE.DataTexture(colorBytes(), COLOR_STOPS.length, 1, THREE.RGBAFormat, THREE.UnsignedByteType);
    colors.minFilter = colors.magFilter = THREE.LinearFilter;
    colors.needsUpdate = true;
    this.noValues = valueTexture(new Uint16Array(1));
    this.material = new THREE.ShaderMaterial({
      glslVersion: THREE.GLSL3,
      side: THREE.DoubleSide,
      vertexShader: document.getElementById("vertex-shader").textContent,
      fragmentShader: document.getElementById("fragment-shader").textContent,
      uniforms: {
        faces: { value: faceTexture(data.faces) },
        positionsBefore: { value: positionTexture(data.positions[0]) },
        positionsAfter: { value: positionTexture(data.positions[1]) },
        valuesBefore: { value: this.noValues },
        valuesAfter: { value: this.noValues },
        blend: { value: 0 },
        valueKind: { value: 0 },
        valueScale: { value: 1 },
        colors: { value: colors },
        colorCount: { value: COLOR_STOPS.length },
        isColored: { value: false },
        hasWires: { value: false },
      },
    });
    const geometry = new THREE.BufferGeometry();
    // No attributes: the vertex shader finds each corner by its number.
    geometry.setDrawRange(0, data.faces.length);
    const mesh = new THREE.Mesh(geometry, this.material);
    mesh.frustumCulled = false;
    this.scene = new THREE.Scene();
    this.scene.add(mesh);
  }

  /** Colours by a layer up to `scaleEnd`, or shows plain clay for null. */
  colorBy(layer, scaleEnd) {
    const { valuesBefore, valuesAfter, valueKind, valueScale, isColored } = this.material.uniforms;
    valuesBefore.value = layer ? layer.before : this.noValues;
    valuesAfter.value = layer ? layer.after : this.noValues;
    valueKind.value = layer ? (layer.per === "face" ? 1 : 2) : 0;
    valueScale.value = layer ? (65534 * scaleEnd) / layer.top : 1;
    isColored.value = layer !== null;
  }

  setWires(hasWires) {
    this.material.uniforms.hasWires.value = hasWires;
  }

  setBlend(blend) {
    this.material.uniforms.blend.value = blend;
  }
}

/** Panes of the canvas, in fractions of it from the upper left: what is drawn where, and how far from before to after. */
function panesOf(state, isTall) {
  if (state.view === "blend") return [{ x: 0, y: 0, width: 1, height: 1, blend: state.slider }];
  if (state.view === "wipe") {
    const whole = { x: 0, y: 0, width: 1, height: 1 };
    return [
      { ...whole, blend: 0, clip: [0, state.slider] },
      { ...whole, blend: 1, clip: [state.slider, 1] },
    ];
  }
  const half = isTall ? { width: 1, height: 0.5 } : { width: 0.5, height: 1 };
  return [
    { x: 0, y: 0, ...half, blend: 0 },
    { x: isTall ? 0 : 0.5, y: isTall ? 0.5 : 0, ...half, blend: 1 },
  ];
}

/** Draws every pane with one camera. */
function drawPanes(renderer, surface, camera, panes) {
  const size = renderer.getSize(new THREE.Vector2());
  renderer.setScissorTest(false);
  renderer.clear();
  renderer.setScissorTest(true);
  for (const pane of panes) {
    const [left, right] = pane.clip || [0, 1];
    const x = Math.round(pane.x * size.x);
    const end = Math.round((pane.x + pane.width) * size.x);
    // three.js counts from the lower left.
    const y = Math.round((1 - pane.y - pane.height) * size.y);
    const top = Math.round((1 - pane.y) * size.y);
    const from = x + Math.round(left * (end - x));
    const to = x + Math.round(right * (end - x));
    if (to <= from) continue;
    renderer.setViewport(x, y, end - x, top - y);
    renderer.setScissor(from, y, to - from, top - y);
    camera.aspect = (end - x) / Math.max(1, top - y);
    camera.updateProjectionMatrix();
    surface.setBlend(pane.blend);
    renderer.render(surface.scene, camera);
  }
}
