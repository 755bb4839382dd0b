"use strict";

/** The page of `gube export`: draws moments of the recording. */
(() => {
  // As in the pictures of gube; garments from the innermost outwards.
  const GARMENTS = [0x5e738c, 0x945c4c, 0x66805c, 0xa1854c], BODY = 0x9e968f;
  const KEY_AZIMUTH = -75, KEY_ELEVATION = 38, RIM_AZIMUTH = 95, RIM_ELEVATION = 25; // from the camera's side [deg]
  const element = (id) => document.getElementById(id);
  const [canvas, play, scrub, clock, speed] = ["canvas", "play", "scrub", "clock", "speed"].map(element);
  const state = { time: 0, playing: false, changed: false };
  let about, arrays, view;

  // --- The recording ------------------------------------------------------------------------------------------------

  async function start() {
    const letters = atob(gubeRecording), bytes = new Uint8Array(letters.length);
    for (let i = 0; i < bytes.length; i++) bytes[i] = letters.charCodeAt(i);
    ({ about, arrays } = await readRecording(bytes));
    view = viewOf();
    describe();
    scrub.max = about.frame_count - 1;
    play.disabled = scrub.disabled = false;
    element("message").textContent = "";
    seek(0);
    setPlaying(true);
    requestAnimationFrame(tick);
  }

  function failed(error) {
    element("message").textContent = `The recording cannot be played: ${error.message}`;
    console.error(error);
  }

  /** Shows a moment, given in frames. */
  function seek(time) {
    state.time = Math.min(Math.max(time, 0), about.frame_count - 1);
    view.show(state.time);
  }

  /** Values of an array. */
  function valuesOf(name) {
    const { scale } = about.arrays[name];
    return Float32Array.from(arrays[name], (steps) => steps * scale);
  }

  /** Points of an array of frames, less a base: a share of the way from its row i to its row j. */
  function mix(name, i, j, share, base, out) {
    const { scale } = about.arrays[name], numbers = arrays[name], count = out.length, from = i * count, to = j * count;
    for (let k = 0; k < count; k += 3) {
      for (let s = 0; s < 3; s++) {
        const before = numbers[from + k + s], after = numbers[to + k + s];
        out[k + s] = scale * (before + share * (after - before)) - base[s];
      }
    }
  }

  /** Rows of an array before and after a time, and how far it is between them. The truth has fewer rows than frames. */
  function rowsAt(name, time) {
    const numbers = name === "frames/truth" ? arrays["truth/numbers"] : [...Array(about.frame_count).keys()];
    const i = Math.max(numbers.findLastIndex((number) => number <= time), 0), j = Math.min(i + 1, numbers.length - 1);
    const share = i === j ? 0 : (time - numbers[i]) / (numbers[j] - numbers[i]);
    return [i, j, Math.max(share, 0)];
  }

  // --- The view -----------------------------------------------------------------------------------------------------

  /** A mesh of one material, or of garments with one each, whose vertices are the points of an array of frames. */
  function meshOf(faces, name, material) {
    const geometry = new THREE.BufferGeometry(), garments = arrays.garments;
    if (Array.isArray(material)) {
      const parts = material.map(() => []);
      for (let i = 0; i < faces.length; i += 3) parts[garments[faces[i]]].push(faces[i], faces[i + 1], faces[i + 2]);
      let start = 0;
      parts.forEach((part, g) => { geometry.addGroup(start, part.length, g); start += part.length; });
      faces = parts.flat();
    }
    geometry.setIndex(new THREE.BufferAttribute(Uint32Array.from(faces), 1));
    for (const attribute of ["position", "normal"]) {
      geometry.setAttribute(attribute, new THREE.BufferAttribute(new Float32Array(3 * about.arrays[name].shape[1]), 3));
    }
    const mesh = new THREE.Mesh(geometry, material);
    mesh.userData.frames = name;
    mesh.frustumCulled = false;
    mesh.castShadow = mesh.receiveShadow = true;
    return mesh;
  }

  function move(mesh, time, base) {
    const { frames } = mesh.userData, { index, attributes: { position, normal } } = mesh.geometry;
    mix(frames, ...rowsAt(frames, time), base, position.array);
    writeNormals(position.array, index.array, normal.array);
    position.needsUpdate = normal.needsUpdate = true;
  }

  /** Unit normals of a mesh, weighted by area: twenty times as fast as those of three.js. */
  function writeNormals(vertices, faces, out) {
    out.fill(0);
    for (let f = 0; f < faces.length; f += 3) {
      const a = 3 * faces[f], b = 3 * faces[f + 1], c = 3 * faces[f + 2];
      const x = vertices[a], y = vertices[a + 1], z = vertices[a + 2];
      const ux = vertices[b] - x, uy = vertices[b + 1] - y, uz = vertices[b + 2] - z;
      const vx = vertices[c] - x, vy = vertices[c + 1] - y, vz = vertices[c + 2] - z;
      const nx = uy * vz - uz * vy, ny = uz * vx - ux * vz, nz = ux * vy - uy * vx;
      out[a] += nx, out[a + 1] += ny, out[a + 2] += nz;
      out[b] += nx, out[b + 1] += ny, out[b + 2] += nz;
      out[c] += nx, out[c + 1] += ny, out[c + 2] += nz;
    }
    for (let i = 0; i < out.length; i += 3) {
      const x = out[i], y = out[i + 1], z = out[i + 2], scale = 1 / Math.max(Math.sqrt(x * x + y * y + z * z), 1e-20);
      out[i] = x * scale, out[i + 1] = y * scale, out[i + 2] = z * scale;
    }
  }

  function middleOf(mesh) {
    const { array, count } = mesh.geometry.getAttribute("position"), middle = [0, 0, 0];
    array.forEach((value, i) => (middle[i % 3] += value / count));
    return middle;
  }

  /** A body with joints, whose matrices are written as they are; see `poseJoints`. */
  function skinnedBody(material) {
    const geometry = new THREE.BufferGeometry();
    geometry.setIndex(new THREE.BufferAttribute(Uint32Array.from(arrays["body/faces"]), 1));
    geometry.setAttribute("position", new THREE.BufferAttribute(valuesOf("body/vertices"), 3));
    geometry.setAttribute("skinIndex", new THREE.BufferAttribute(Uint16Array.from(arrays["body/joints"]), 4));
    geometry.setAttribute("skinWeight", new THREE.BufferAttribute(valuesOf("body/weights"), 4));
    geometry.computeVertexNormals();
    const bones = Array.from({ length: about.arrays["frames/matrices"].shape[1] }, () => new THREE.Bone());
    const mesh = new THREE.SkinnedMesh(geometry, material);
    mesh.bind(new THREE.Skeleton(bones, bones.map((bone) => bone.matrixWorld.clone())), mesh.matrixWorld);
    mesh.frustumCulled = false;
    mesh.castShadow = mesh.receiveShadow = true;
    return mesh;
  }

  function poseJoints({ skeleton: { bones } }, time, base) {
    const matrices = new Float32Array(9 * bones.length), places = new Float32Array(3 * bones.length);
    mix("frames/matrices", ...rowsAt("frames/matrices", time), [0, 0, 0], matrices);
    mix("frames/places", ...rowsAt("frames/places", time), base, places);
    bones.forEach((bone, j) => {
      const row = (a) => [...matrices.subarray(9 * j + 3 * a, 9 * j + 3 * a + 3), places[3 * j + a]];
      bone.matrixWorld.set(...row(0), ...row(1), ...row(2), 0, 0, 0, 1);
    });
  }

  function directionOf(azimuth, elevation) {
    const [a, e] = [azimuth, elevation].map((angle) => (angle * Math.PI) / 180);
    return new THREE.Vector3(Math.sin(a) * Math.cos(e), Math.sin(e), Math.cos(a) * Math.cos(e));
  }

  function viewOf() {
    const renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
    renderer.shadowMap.enabled = true;
    renderer.shadowMap.type = THREE.PCFShadowMap;
    const scene = new THREE.Scene();
    const last = "garments" in arrays ? arrays.garments.reduce((a, b) => Math.max(a, b)) : 0;
    const cloths = Array.from({ length: last + 1 }, (_, g) => new THREE.MeshPhysicalMaterial({
      color: GARMENTS[g % GARMENTS.length], roughness: 0.85, side: THREE.DoubleSide, sheen: 0.7, sheenRoughness: 0.55,
      sheenColor: new THREE.Color(0xb9c4d2),
    }));
    const cloth = last ? cloths : cloths[0];
    const skin = new THREE.MeshStandardMaterial({ color: BODY, roughness: 0.8 });
    const garments = {
      coarse: meshOf(arrays["faces/coarse"], "frames/coarse", cloth),
      ours: meshOf(arrays["faces/fine"], "frames/fine", cloth),
    };
    if (about.arrays["frames/truth"]) garments.truth = meshOf(arrays["faces/fine"], "frames/truth", cloth);
    const jointed = "frames/matrices" in arrays;
    const body = jointed ? skinnedBody(skin) : meshOf(arrays["body/faces"], "frames/body", skin);
    const floor = new THREE.Mesh(new THREE.PlaneGeometry(40, 40), new THREE.ShadowMaterial({ opacity: 0.35 }));
    floor.rotation.x = -Math.PI / 2;
    floor.receiveShadow = true;
    scene.add(...Object.values(garments), body, floor);

    const key = new THREE.DirectionalLight(0xfff4e6, 3.1), rim = new THREE.DirectionalLight(0xdfe8ff, 0.9);
    key.castShadow = true;
    key.shadow.mapSize.set(1024, 1024);
    key.shadow.radius = 2.5;
    key.shadow.normalBias = 0.01;
    const reach = 1.5; // around the garment [m]
    Object.assign(key.shadow.camera, { left: -reach, right: reach, top: reach, bottom: -reach, near: 0.5, far: 9 });
    scene.add(new THREE.HemisphereLight(0xf2f4f8, 0x8a8480, 1.15), key, key.target, rim, rim.target);

    const camera = new THREE.PerspectiveCamera(28, 1, 0.05, 60), centre = new THREE.Vector3();
    const orbit = new THREE.OrbitControls(camera, canvas);
    orbit.enableDamping = true;
    orbit.dampingFactor = 0.15;
    move(garments.coarse, 0, [0, 0, 0]);
    const base = middleOf(garments.coarse); // everything is drawn about the garment's first place
    floor.position.y = about.floor - base[1];
    // The first view shows the whole body.
    if (!jointed) move(body, 0, base);
    const heights = body.geometry.getAttribute("position").array.filter((_, i) => i % 3 === 1);
    const height = heights.reduce((a, b) => Math.max(a, b)) - heights.reduce((a, b) => Math.min(a, b));
    orbit.target.set(0, floor.position.y + height / 2, 0);
    camera.position.copy(directionOf(25, 6)).multiplyScalar(2.3 * height).add(orbit.target);
    element("labels").replaceChildren(...Object.keys(garments).map((name) => {
      const label = document.createElement("span");
      label.textContent = name;
      return label;
    }));

    /** Takes over a moment, given in frames. The camera goes along with the garment. */
    function show(time) {
      for (const mesh of Object.values(garments)) move(mesh, time, base);
      if (jointed) poseJoints(body, time, base);
      else move(body, time, base);
      const now = new THREE.Vector3(...middleOf(garments.coarse));
      const shift = new THREE.Vector3(now.x - centre.x, 0, now.z - centre.z);
      centre.copy(now);
      camera.position.add(shift);
      orbit.target.add(shift);
      state.changed = true;
    }

    /** Lights keep their places relative to the camera, so that folds have a bright and a dark side in every view. */
    function light() {
      const offset = camera.position.clone().sub(orbit.target);
      const around = (Math.atan2(offset.x, offset.z) * 180) / Math.PI;
      key.target.position.copy(centre);
      key.position.copy(directionOf(around + KEY_AZIMUTH, KEY_ELEVATION)).multiplyScalar(4).add(centre);
      rim.target.position.copy(centre);
      rim.position.copy(directionOf(around + RIM_AZIMUTH, RIM_ELEVATION)).add(centre);
    }

    /** Draws the panes if anything has changed. */
    function draw() {
      if (!orbit.update() && !state.changed) return;
      state.changed = false;
      const width = canvas.clientWidth, height = canvas.clientHeight, panes = Object.entries(garments);
      renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
      renderer.setSize(width, height, false);
      light();
      for (const material of cloths) material.wireframe = element("wireframe").checked;
      body.visible = element("body").checked;
      camera.aspect = width / panes.length / height;
      camera.updateProjectionMatrix();
      renderer.setScissorTest(true);
      panes.forEach(([, shown], pane) => {
        const left = Math.round((pane * width) / panes.length), right = Math.round(((pane + 1) * width) / panes.length);
        for (const mesh of Object.values(garments)) mesh.visible = mesh === shown;
        renderer.setViewport(left, 0, right - left, height);
        renderer.setScissor(left, 0, right - left, height);
        renderer.render(scene, camera);
      });
    }
    return { show, draw, garments, base };
  }

  // --- Controls -----------------------------------------------------------------------------------------------------

  function setPlaying(playing) {
    state.playing = playing;
    state.last = null;
    play.textContent = playing ? "Pause" : "Play";
  }

  function tick(now) {
    if (state.playing) {
      const passed = state.last ? Math.min(now - state.last, 100) / 1000 : 0, end = about.frame_count - 1;
      state.last = now;
      const time = state.time + passed * Number(speed.value) * about.rate_hz;
      seek(time > end ? 0 : time);
    }
    scrub.value = state.time;
    const [seconds, all] = [state.time, about.frame_count - 1].map((frames) => (frames / about.rate_hz).toFixed(2));
    clock.textContent = `${seconds} / ${all} s`;
    view.draw();
    requestAnimationFrame(tick);
  }

  for (const id of ["wireframe", "body"]) element(id).addEventListener("change", () => (state.changed = true));
  addEventListener("resize", () => (state.changed = true));
  play.addEventListener("click", () => setPlaying(!state.playing));
  scrub.addEventListener("input", () => {
    setPlaying(false);
    seek(Number(scrub.value));
  });
  addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (event.target.closest("button, input, select") || !about || (event.key !== " " && !step)) return;
    event.preventDefault();
    setPlaying(event.key === " " && !state.playing);
    if (step) seek(Math.round(state.time) + step);
  });

  // --- Words: every name comes from a file, so that it is only ever set as text -------------------------------------

  function row(cells, kind = "td") {
    const line = document.createElement("tr");
    line.append(...cells.map(([text, style]) => {
      const cell = document.createElement(kind);
      cell.textContent = text;
      cell.className = style;
      return cell;
    }));
    return line;
  }

  function describe() {
    document.title = `${about.garment}: ${about.motion}`;
    element("title").textContent = `${about.garment}, ${about.motion}`;
    element("verdict").append(...about.verdict.map((sentence) => {
      const paragraph = document.createElement("p");
      paragraph.textContent = sentence;
      return paragraph;
    }));
    element("facts").append(...about.facts.map(([name, value]) => row([[name, ""], [value, ""]])));
    const { columns, first, rest } = about.figures;
    const numbers = (texts) => texts.map((text) => [text, "number"]);
    const heading = (title) => row([[title, "name"], ...numbers(columns), ["Meaning", ""]], "th");
    const figure = ({ name, values, meaning }) => row([[name, "name"], ...numbers(values), [meaning, ""]]);
    for (const { title, rows } of first) element("figures").append(heading(title), ...rows.map(figure));
    element("more").hidden = !rest.length;
    element("more-figures").append(heading("Figure"), ...rest.map(figure));
  }

  /** For tests: waits until a moment is drawn; vertices by name, about a base. */
  window.gubePage = {
    state,
    async shown(time) {
      const next = () => new Promise(requestAnimationFrame);
      while (!view) await next();
      setPlaying(false);
      seek(time);
      await next();
      await next();
      const shown = { time: state.time, base: view.base };
      for (const [name, mesh] of Object.entries(view.garments)) {
        shown[name] = mesh.geometry.getAttribute("position").array;
      }
      return shown;
    },
  };
  start().catch(failed);
})();
