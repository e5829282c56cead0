// The picture: one frame of shapes, magnets and sensors, drawn by three.js whenever something changes.
// Lengths are in mm. The base of the robot is at the origin, z is drawn upwards.

import {
  BufferGeometry, CanvasTexture, CatmullRomCurve3, ConeGeometry, CylinderGeometry, DirectionalLight, DoubleSide,
  GridHelper, Group, HemisphereLight, Line, LineBasicMaterial, Mesh, MeshPhongMaterial, PerspectiveCamera, Scene,
  SphereGeometry, Spherical, Sprite, SpriteMaterial, SRGBColorSpace, TubeGeometry, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

const FIELD_OF_VIEW_DEG = 30;
const MARGIN = 1.04; // around the box, for the letters of the axes
const FIRST_VIEW = new Vector3(1, -1.7, 0.65).normalize(); // close to the view of the companion's other 3-D figures
const AROUND = 20; // sides of a tube
const ALONG = 72; // rings of a tube
const Y = new Vector3(0, 1, 0); // axis of the cylinders and cones of three.js

/** A tube around points, `radii` one for each of them (or one number for all): may vary along the tube. */
function tube(points, radii) {
  const places = vectors(points);
  const geometry = new TubeGeometry(new CatmullRomCurve3(places, false, "centripetal"), ALONG, 0, AROUND);
  const position = geometry.attributes.position;
  const normal = geometry.attributes.normal;
  for (let vertex = 0; vertex < position.count; vertex++) {
    const at = (Math.floor(vertex / (AROUND + 1)) / ALONG) * (places.length - 1);
    const before = Math.min(Math.floor(at), places.length - 2);
    const radius = typeof radii === "number"
      ? radii
      : radii[before] + (at - before) * (radii[before + 1] - radii[before]);
    position.setXYZ(
      vertex,
      position.getX(vertex) + radius * normal.getX(vertex),
      position.getY(vertex) + radius * normal.getY(vertex),
      position.getZ(vertex) + radius * normal.getZ(vertex),
    );
  }
  return geometry;
}

/** Flat numbers x, y, z, x, ... as vectors. */
function vectors(numbers) {
  const found = [];
  for (let i = 0; i + 2 < numbers.length; i += 3) found.push(new Vector3(numbers[i], numbers[i + 1], numbers[i + 2]));
  return found;
}

function material(colour, opacity = 1) {
  return new MeshPhongMaterial({
    color: colour, specular: "#333333", shininess: 25, side: DoubleSide,
    opacity, transparent: opacity < 1, depthWrite: opacity === 1,
  });
}

/** A letter that always faces the reader. */
function letter(text, colour, size) {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 64;
  const pen = canvas.getContext("2d");
  Object.assign(pen, { font: "italic 52px serif", textAlign: "center", textBaseline: "middle", fillStyle: colour });
  pen.fillText(text, 32, 32);
  const map = new CanvasTexture(canvas);
  map.colorSpace = SRGBColorSpace;
  const sprite = new Sprite(new SpriteMaterial({ map, depthWrite: false }));
  sprite.scale.setScalar(size);
  return sprite;
}

/** Free what the graphics card holds of everything below `group`, and empty it. */
function clear(group) {
  group.traverse((part) => {
    part.geometry?.dispose();
    part.material?.map?.dispose();
    part.material?.dispose();
  });
  group.clear();
}

/** Side of a square of the floor [mm]: a round number, such that at most sixteen fit across. */
export function gridStep(reach) {
  const least = reach / 8;
  const power = 10 ** Math.floor(Math.log10(least));
  return power * [1, 2, 5, 10].find((factor) => factor * power >= least);
}

/**
 * Prepare a canvas; returns null where the browser has no WebGL.
 *
 * `box` holds two corners around everything that will be drawn, `radius` is that of the body [mm].
 */
export function createScene(canvas, { box, radius, widest = Infinity, zoom = 1 }, palette) {
  const context = canvas.getContext("webgl2", { alpha: true, antialias: true });
  if (!context) return null;
  const renderer = new WebGLRenderer({ canvas, context, alpha: true, antialias: true });
  renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
  const scene = new Scene();
  const camera = new PerspectiveCamera(FIELD_OF_VIEW_DEG, 1, 1, 1e5);
  camera.up.set(0, 0, 1);
  const lamp = new DirectionalLight("#ffffff", 1.6);
  camera.add(lamp);
  scene.add(camera, new HemisphereLight("#ffffff", "#999999", 2.2));
  const floor = new Group();
  const robot = new Group();
  scene.add(floor, robot);

  const [low, high] = box.map((corner) => new Vector3(...corner));
  const centre = low.clone().add(high).divideScalar(2);
  const reach = Math.max(...[low.x, low.y, high.x, high.y].map(Math.abs));
  const step = gridStep(reach);
  const half = step * Math.ceil(reach / step);
  const corners = [[half, half, 0], [half, -half, 0], [-half, half, 0], [-half, -half, 0]];
  for (const x of [low.x, high.x]) for (const y of [low.y, high.y]) corners.push([x, y, low.z], [x, y, high.z]);
  const axisHeight = Math.max(1.08 * high.z, 0.4 * half); // also of an arm that hangs
  const size = Math.max(radius, low.distanceTo(high) / 35); // parts of a slender robot are drawn larger than it is
  const controls = new OrbitControls(camera, canvas);
  canvas.style.touchAction = "pan-y"; // a finger that moves up or down scrolls the page, as elsewhere
  controls.enablePan = false;
  controls.enableZoom = false; // the wheel scrolls the page until the reader has chosen the picture
  let turned = false;
  const render = () => renderer.render(scene, camera);
  controls.addEventListener("start", () => { turned = true; });
  controls.addEventListener("change", render);

  /** How far away the eye must be for the floor and the box above it to be in the picture. */
  function distanceOf(direction) {
    const up = Math.tan((FIELD_OF_VIEW_DEG * Math.PI) / 360) / MARGIN;
    const right = new Vector3().crossVectors(camera.up, direction).normalize();
    const above = new Vector3().crossVectors(direction, right);
    let distance = 0;
    for (const [x, y, z] of corners) {
      const corner = new Vector3(x, y, z).sub(centre);
      const needed = Math.max(Math.abs(corner.dot(right)) / (up * camera.aspect), Math.abs(corner.dot(above)) / up);
      distance = Math.max(distance, needed + corner.dot(direction));
    }
    return distance;
  }

  function resetView() {
    const distance = distanceOf(FIRST_VIEW) / zoom;
    controls.target.copy(centre);
    camera.position.copy(FIRST_VIEW).multiplyScalar(distance).add(centre);
    camera.near = distance / 100;
    camera.far = distance * 20;
    camera.updateProjectionMatrix();
    controls.update();
    turned = false;
    render();
  }

  /** Turn the view by angles [rad], and bring the eye nearer by a factor. */
  function move(sideways, upwards, factor = 1) {
    // Spherical measures from y: seen from the eye, our z is its y
    const eye = camera.position.clone().sub(controls.target);
    const place = new Spherical().setFromCartesianCoords(eye.x, eye.z, -eye.y);
    place.theta += sideways;
    place.phi = Math.min(Math.max(place.phi - upwards, 0.02), Math.PI - 0.02);
    place.radius *= factor;
    const moved = new Vector3().setFromSpherical(place);
    camera.position.set(moved.x, -moved.z, moved.y).add(controls.target);
    turned = true;
    controls.update();
    render();
  }

  function drawFloor() {
    clear(floor);
    const grid = new GridHelper(2 * half, (2 * half) / step, palette.axes, palette.grid);
    grid.rotation.x = Math.PI / 2;
    floor.add(grid);
    const length = half * 1.08;
    for (const [name, end] of [["x", [length, 0, 0]], ["y", [0, length, 0]], ["z", [0, 0, axisHeight]]]) {
      const tip = new Vector3(...end);
      const line = new BufferGeometry().setFromPoints([new Vector3(), tip]);
      const text = letter(name, palette.axes, low.distanceTo(high) * 0.055);
      text.position.copy(tip).multiplyScalar(1.06);
      floor.add(new Line(line, new LineBasicMaterial({ color: palette.axes })), text);
    }
  }

  /** Copies of small parts along y, one for each point, turned into its direction. */
  function addMarkers({ points, directions }, parts, colour) {
    const places = vectors(points);
    const axes = vectors(directions);
    const paint = material(colour);
    places.forEach((place, i) => {
      const marker = new Group();
      for (const part of parts) marker.add(new Mesh(part, paint));
      marker.position.copy(place);
      marker.quaternion.setFromUnitVectors(Y, axes[i].normalize());
      robot.add(marker);
    });
  }

  const arrow = [
    new CylinderGeometry(0.045 * size, 0.045 * size, 0.7 * size, 8).translate(0, 0.35 * size, 0),
    new ConeGeometry(0.13 * size, 0.35 * size, 12).translate(0, 0.85 * size, 0),
    new SphereGeometry(0.1 * size, 12, 8),
  ];
  const cylinder = [new CylinderGeometry(0.5 * size, 0.5 * size, 0.27 * size, 28)];

  /** Draw a frame: `shapes` with `role`, `points` and perhaps `deviation`, then `magnets`, `sensors` and `suspects`. */
  function draw(frame) {
    clear(robot);
    frame.shapes.forEach(({ role, points, deviation }, i) => {
      // Of two, the first is a wide glass tube: a good estimate is seen inside it, a bad one leaves it
      const glass = i === 0 && frame.shapes.length > 1;
      const thickness = size * (glass ? 0.16 : 0.08);
      const paint = material(palette[role], glass ? 0.35 : 1);
      const tip = new Mesh(new SphereGeometry(1.5 * thickness, 16, 12), paint);
      tip.position.fromArray(points, points.length - 3);
      robot.add(new Mesh(tube(points, thickness), paint), tip);
      if (i === 0) robot.add(new Mesh(tube(points, radius), material(palette.body, 0.2)));
      if (deviation) {
        const around = Array.from(deviation, (sigma) => Math.min(2 * sigma, widest));
        robot.add(new Mesh(tube(points, around), material(palette.deviation, 0.4)));
      }
    });
    if (frame.magnets) addMarkers(frame.magnets, cylinder, palette.magnets);
    if (frame.sensors) addMarkers(frame.sensors, arrow, palette.sensors);
    for (const k of frame.suspects ?? []) {
      const ball = new Mesh(new SphereGeometry(0.6 * size, 20, 14), material(palette.suspects, 0.6));
      ball.position.fromArray(frame.sensors.points, 3 * k);
      robot.add(ball);
    }
    render();
  }

  function setPalette(next) {
    palette = next;
    drawFloor();
  }

  function resize(width, height) {
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    if (turned) render();
    else resetView();
  }

  function dispose() {
    controls.dispose();
    clear(scene);
    renderer.dispose();
    renderer.forceContextLoss();
  }

  drawFloor();
  return { draw, setPalette, resize, resetView, move, step, dispose, zoomByWheel: (on) => { controls.enableZoom = on; } };
}
