// The one camera of all panes: framing, turning by mouse, touch and keys.
const AZIMUTH = 35;
const ELEVATION = 25;
const SAMPLES = 10000;
const MARGIN = 1.06;

class View {
  constructor(canvas, positions, onChange) {
    this.canvas = canvas;
    this.onChange = onChange;
    this.camera = new THREE.PerspectiveCamera(30, 1, 0.01, 100);
    this.samples = sampled(positions);
    this.isMoved = false;
    this.up = "z";
    this.controls = null;
    this.setUp("z");
  }

  /** Makes z or y point up; the view starts anew, since the controls keep to one axis. */
  setUp(axis) {
    this.up = axis;
    this.camera.up.set(0, axis === "y" ? 1 : 0, axis === "z" ? 1 : 0);
    if (this.controls) this.controls.dispose();
    this.controls = new THREE.OrbitControls(this.camera, this.canvas);
    this.controls.minDistance = 0.02;
    this.controls.maxDistance = 40;
    this.controls.addEventListener("start", () => (this.isMoved = true));
    this.controls.addEventListener("change", this.onChange);
  }

  /** Looks at the whole mesh from the first direction, in a pane of this shape (width over height). */
  reset(aspect) {
    const [a, e] = [AZIMUTH, ELEVATION].map((degrees) => (degrees * Math.PI) / 180);
    const [across, ahead, above] = [Math.cos(e) * Math.sin(a), Math.cos(e) * Math.cos(a), Math.sin(e)];
    const back = this.up === "z" ? new THREE.Vector3(ahead, across, above) : new THREE.Vector3(across, above, ahead);
    this.isMoved = false;
    const { target, distance } = this.framing(back, aspect);
    this.controls.target.copy(target);
    this.camera.position.copy(target).addScaledVector(back, distance);
    this.controls.update();
    this.onChange();
  }

  /** The target and the least distance from it along `back` with which every sampled vertex is inside the pane. */
  framing(back, aspect) {
    const right = new THREE.Vector3().crossVectors(this.camera.up, back).normalize();
    const above = new THREE.Vector3().crossVectors(back, right);
    const tall = Math.tan((this.camera.fov * Math.PI) / 360) / MARGIN;
    const target = new THREE.Vector3();
    let distance = this.distance(target, back, right, above, tall, aspect);
    // What is near looks larger, so the middle of the picture is not that of the mesh; a few steps find it.
    for (let step = 0; step < 6; step++) {
      for (const axis of [right, above]) {
        const [low, high] = this.extent(target, back, axis, distance);
        target.addScaledVector(axis, (distance * (low + high)) / 2);
      }
      distance = this.distance(target, back, right, above, tall, aspect);
    }
    return { target, distance };
  }

  distance(target, back, right, above, tall, aspect) {
    const point = new THREE.Vector3();
    let distance = 0;
    for (let i = 0; i < this.samples.length; i += 3) {
      point.fromArray(this.samples, i).sub(target);
      const needed = Math.max(Math.abs(point.dot(right)) / (tall * aspect), Math.abs(point.dot(above)) / tall);
      distance = Math.max(distance, needed + point.dot(back));
    }
    return distance;
  }

  /** Least and greatest place of the samples along an axis of the picture, as seen from this distance. */
  extent(target, back, axis, distance) {
    const point = new THREE.Vector3();
    let [low, high] = [Infinity, -Infinity];
    for (let i = 0; i < this.samples.length; i += 3) {
      point.fromArray(this.samples, i).sub(target);
      const place = point.dot(axis) / (distance - point.dot(back));
      low = Math.min(low, place);
      high = Math.max(high, place);
    }
    return [low, high];
  }

  /** Keeps all of the mesh, which lies within 1 of the origin, between the near and the far plane. */
  clipToMesh() {
    const distance = this.camera.position.length();
    this.camera.near = Math.max(0.002, distance - 1.1);
    this.camera.far = distance + 1.1;
  }

  /** Turns around the target by degrees to the right and up. */
  turn(degreesRight, degreesUp) {
    const offset = this.camera.position.clone().sub(this.controls.target);
    const toY = this.up === "z" ? (v) => v.set(v.y, v.z, v.x) : (v) => v;
    const fromY = this.up === "z" ? (v) => v.set(v.z, v.x, v.y) : (v) => v;
    const around = new THREE.Spherical().setFromVector3(toY(offset));
    around.theta += (degreesRight * Math.PI) / 180;
    around.phi -= (degreesUp * Math.PI) / 180;
    around.makeSafe();
    this.moveTo(fromY(offset.setFromSpherical(around)));
  }

  /** Multiplies the distance to the target. */
  zoom(factor) {
    const offset = this.camera.position.clone().sub(this.controls.target);
    const { minDistance, maxDistance } = this.controls;
    this.moveTo(offset.setLength(Math.min(maxDistance, Math.max(minDistance, offset.length() * factor))));
  }

  moveTo(offset) {
    this.isMoved = true;
    this.camera.position.copy(this.controls.target).add(offset);
    this.controls.update();
    this.onChange();
  }
}

/** Some vertices of all meshes, spread evenly over their numbers. */
function sampled(positions) {
  const points = [];
  for (const own of positions) {
    const n = own.length / 3;
    const step = Math.max(1, Math.floor(n / SAMPLES));
    for (let i = 0; i < n; i += step) points.push(own[3 * i], own[3 * i + 1], own[3 * i + 2]);
  }
  return points;
}
