"use strict";

/** The page of `gube export`: asks the worker for moments of the recording and draws them. */
(() => {
  // As in the pictures of gube; garments from the innermost outwards.
  const GARMENTS = [0x5e738c, 0x945c4c, 0x66805c, 0xa1854c], BODY = 0x9e968f;
  const KEY_AZIMUTH = -75, KEY_ELEVATION = 38, RIM_AZIMUTH = 95, RIM_ELEVATION = 25; // from the camera's side [deg]
  const element = (id) => document.getElementById(id);
  const [canvas, play, scrub, clock, speed, cost] = ["canvas", "play", "scrub", "clock", "speed", "cost"].map(element);
  const state = { time: 0, playing: false, waiting: false, wanted: null, costs: [], moment: null, changed: false };
  let about, arrays, worker, view;

  // --- The worker ---------------------------------------------------------------------------------------------------

  function bytesOf(base64) {
    return Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
  }

  function start() {
    // A page opened from a disk may load no other file, so that the worker's program is put together here.
    const program = [gubeDecoder, gubeLoops, gubeWorker].map(String).join("\n") + "\ngubeWorker();";
    worker = new Worker(URL.createObjectURL(new Blob([program], { type: "text/javascript" })));
    worker.onerror = (event) => failed(event.message);
    worker.onmessage = ({ data }) => ({ loaded, decoded, failed: () => failed(data.message) })[data.kind](data);
    const recording = bytesOf(gubeRecording.recording);
    worker.postMessage({ kind: "load", recording, loops: bytesOf(gubeRecording.loops) }, [recording.buffer]);
  }

  function failed(message) {
    element("message").textContent = `The recording cannot be played: ${message}`;
    console.error(message);
  }

  function loaded(data) {
    ({ about, arrays } = data);
    view = viewOf();
    describe();
    scrub.max = about.frame_count - 1;
    play.disabled = scrub.disabled = false;
    seek(0);
    requestAnimationFrame(tick);
  }

  /** Shows a moment, given in frames, as soon as it is decoded; of several only the last one. */
  function seek(time) {
    state.time = Math.min(Math.max(time, 0), about.frame_count - 1);
    state.wanted = state.time;
    if (!state.waiting) ask();
  }

  function ask() {
    state.waiting = true;
    worker.postMessage({ kind: "decode", time: state.wanted });
    state.wanted = null;
  }

  function decoded(moment) {
    state.waiting = false;
    state.moment = moment;
    state.costs = [...state.costs.slice(-59), [moment.decodeMs, moment.normalsMs]];
    if (element("message").textContent) {
      element("message").textContent = "";
      setPlaying(true);
    }
    view.show(moment);
    if (state.wanted !== null) ask();
  }

  // --- The view -----------------------------------------------------------------------------------------------------

  /** A mesh of one material, or of garments with one each. */
  function meshOf(faces, count, material) {
    const geometry = new THREE.BufferGeometry(), garments = arrays.garments;
    if (Array.isArray(material)) {
      const parts = material.map(() => []);
      for (let i = 0; i < faces.length; i += 3) parts[garments[faces[i]]].push(faces[i], faces[i + 1], faces[i + 2]);
      let start = 0;
      parts.forEach((part, g) => { geometry.addGroup(start, part.length, g); start += part.length; });
      faces = parts.flat();
    }
    geometry.setIndex(new THREE.BufferAttribute(Uint32Array.from(faces), 1));
    for (const name of ["position", "normal"]) {
      geometry.setAttribute(name, new THREE.BufferAttribute(new Float32Array(3 * count), 3));
    }
    const mesh = new THREE.Mesh(geometry, material);
    mesh.frustumCulled = false;
    mesh.castShadow = mesh.receiveShadow = true;
    return mesh;
  }

  function write(mesh, vertices, normals) {
    for (const [name, values] of [["position", vertices], ["normal", normals]]) {
      mesh.geometry.getAttribute(name).array.set(values);
      mesh.geometry.getAttribute(name).needsUpdate = true;
    }
  }

  /** A body with joints, whose matrices are written as they are; see `poseJoints`. */
  function skinnedBody(material) {
    const geometry = new THREE.BufferGeometry();
    geometry.setIndex(new THREE.BufferAttribute(Uint32Array.from(arrays["body/faces"]), 1));
    geometry.setAttribute("position", new THREE.BufferAttribute(arrays["body/vertices"], 3));
    geometry.setAttribute("skinIndex", new THREE.BufferAttribute(arrays["body/joints"], 4));
    geometry.setAttribute("skinWeight", new THREE.BufferAttribute(arrays["body/weights"], 4));
    geometry.computeVertexNormals();
    const bones = Array.from({ length: about.arrays["frames/matrices"].shape[1] }, () => new THREE.Bone());
    const mesh = new THREE.SkinnedMesh(geometry, material);
    mesh.bind(new THREE.Skeleton(bones, bones.map((bone) => bone.matrixWorld.clone())), mesh.matrixWorld);
    mesh.frustumCulled = false;
    mesh.castShadow = mesh.receiveShadow = true;
    return mesh;
  }

  /** Number i of an array of frames, of so many numbers each, at a time. */
  function at(name, count, time, i) {
    const k = Math.floor(time), next = Math.min(k + 1, about.frame_count - 1), steps = arrays[name];
    const before = steps[k * count + i], after = steps[next * count + i];
    return about.arrays[name].scale * (before + (time - k) * (after - before));
  }

  function poseJoints({ skeleton: { bones } }, time, base) {
    const count = bones.length;
    bones.forEach((bone, j) => {
      const m = (a, b) => at("frames/matrices", 9 * count, time, 9 * j + 3 * a + b);
      const t = (a) => at("frames/places", 3 * count, time, 3 * j + a) - base[a];
      const row = (a) => [m(a, 0), m(a, 1), m(a, 2), t(a)];
      bone.matrixWorld.set(...row(0), ...row(1), ...row(2), 0, 0, 0, 1);
    });
  }

  function poseVertices(mesh, time, origin) {
    const position = mesh.geometry.getAttribute("position"), count = position.array.length;
    for (let i = 0; i < count; i++) position.array[i] = at("frames/body", count, time, i);
    position.needsUpdate = true;
    mesh.geometry.computeVertexNormals();
    mesh.position.copy(origin);
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
    const fineCount = about.arrays["frames/correction"].shape[1];
    const garments = {
      coarse: meshOf(arrays["faces/coarse"], about.arrays["frames/coarse"].shape[1], cloth),
      ours: meshOf(arrays["faces/fine"], fineCount, cloth),
    };
    if (about.arrays["frames/truth"]) garments.truth = meshOf(arrays["faces/fine"], fineCount, cloth);
    const jointed = "frames/matrices" in arrays;
    const body = jointed ? skinnedBody(skin) : meshOf(arrays["body/faces"], about.arrays["frames/body"].shape[1], skin);
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
    const base = [0, 1, 2].map((a) => at("frames/origin", 3, 0, a)); // everything is drawn about the first origin
    floor.position.y = about.floor - base[1];
    // The first view shows the whole body.
    const count = body.geometry.getAttribute("position").array.length;
    const placed = (i) => (jointed ? arrays["body/vertices"][i] : at("frames/body", count, 0, i));
    const heights = Array.from({ length: count / 3 }, (_, i) => placed(3 * i + 1));
    const height = heights.reduce((a, b) => Math.max(a, b)) - heights.reduce((a, b) => Math.min(a, b));
    orbit.target.set(0, floor.position.y + height / 2, 0);
    camera.position.copy(directionOf(25, 6)).multiplyScalar(2.3 * height).add(orbit.target);
    element("labels").replaceChildren(...Object.keys(garments).map((name) => {
      const label = document.createElement("span");
      label.textContent = name;
      return label;
    }));

    /** Takes over a moment that the worker has decoded. The camera goes along with the garment. */
    function show(moment) {
      const now = new THREE.Vector3(...moment.origin.map((value, a) => value - base[a]));
      const shift = new THREE.Vector3(now.x - centre.x, 0, now.z - centre.z);
      centre.copy(now);
      camera.position.add(shift);
      orbit.target.add(shift);
      write(garments.ours, moment.fine, moment.normals);
      write(garments.coarse, moment.coarse, moment.coarseNormals);
      if (garments.truth) write(garments.truth, moment.truth, moment.truthNormals);
      for (const mesh of Object.values(garments)) mesh.position.copy(now);
      if (jointed) poseJoints(body, moment.time, base);
      else poseVertices(body, moment.time, now);
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
    return { show, draw };
  }

  // --- Controls -----------------------------------------------------------------------------------------------------

  function setPlaying(playing) {
    state.playing = playing;
    state.last = null;
    play.textContent = playing ? "Pause" : "Play";
  }

  function median(values) {
    return values.sort((a, b) => a - b)[values.length >> 1];
  }

  function tick(now) {
    if (state.playing && !state.waiting) {
      const passed = state.last ? Math.min(now - state.last, 100) / 1000 : 0, end = about.frame_count - 1;
      state.last = now;
      const time = state.time + passed * Number(speed.value) * about.rate_hz;
      seek(time > end ? 0 : time);
    }
    scrub.value = state.time;
    const [seconds, all] = [state.time, about.frame_count - 1].map((frames) => (frames / about.rate_hz).toFixed(2));
    clock.textContent = `${seconds} / ${all} s`;
    if (state.costs.length) {
      const [decode, normals] = [0, 1].map((part) => median(state.costs.map((costs) => costs[part])).toFixed(1));
      const count = about.arrays["frames/correction"].shape[1];
      cost.textContent = `decoding ${decode} ms, normals ${normals} ms a frame of ${count} vertices`;
    }
    if (state.moment) view.draw();
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
    element("facts").append(...about.facts.map(([name, value]) => row([[name, ""], [value, ""]])));
    const { columns, first, rest } = about.figures;
    const numbers = (texts) => texts.map((text) => [text, "number"]);
    const heading = (title) => row([[title, "name"], ...numbers(columns), ["Meaning", ""]], "th");
    const figure = ({ name, values, meaning }) => row([[name, "name"], ...numbers(values), [meaning, ""]]);
    for (const { title, rows } of first) element("figures").append(heading(title), ...rows.map(figure));
    element("more").hidden = !rest.length;
    element("more-figures").append(heading("Figure"), ...rest.map(figure));
  }

  /** For tests: what is drawn, and a way to wait until a moment is. */
  window.gubePage = {
    state,
    async shown(time) {
      while (!state.moment) await new Promise(requestAnimationFrame);
      setPlaying(false);
      seek(time);
      while (state.moment.time !== time) await new Promise(requestAnimationFrame);
      await new Promise(requestAnimationFrame);
      return state.moment;
    },
  };
  start();
})();
