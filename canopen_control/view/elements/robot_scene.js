// three.js is loaded after the page, so that STOP and the state never wait for the picture. The scene is drawn only after
// a change and while it is visible, and with fewer pixels where the CPU draws it.
const FAULT = 0xd62828, SLOW_MS = 45, LEAST_RATIO = 0.5, MOST_POINTS = 1500;
const ODOMETRY = 0x266ec8, TRUE = 0xe07a00; // colours of the paths by odometry and of the base itself
const FIXED = 0x9aa7b5, MOVING = 0xc79a5b, OTHER = 0x8d7fc7; // colours of objects in the world: fixed, movable, other robots
const LOW_FRICTION = 0x6fb7d6, HIGH_FRICTION = 0xb98a6a, USUAL = 0.5; // colours of floor patches by friction
const GHOST = { color: 0x1d5fd1, transparent: true, opacity: 0.35, depthWrite: false };
const NONE = "This browser cannot draw 3D (no WebGL). All other parts of this page work.";

export default {
  template: `
    <div>
      <canvas ref="canvas"></canvas>
      <p v-if="note" class="cc-no-scene">{{ note }}</p>
    </div>`,
  props: { tree: Object },
  data: () => ({ note: "" }),
  async mounted() {
    this.follow = this.visible = true;
    this.drawn = 0;
    this.latest = {};
    this.robot = JSON.parse(JSON.stringify(this.tree)); // a plain copy, which Vue does not observe
    this.listen("cc-scene", (event) => this.move(event.detail));
    this.trails = { trail: { color: ODOMETRY, points: [] }, truth: { color: TRUE, points: [] } };
    for (const name of ["trail", "truth"]) this.listen(`cc-${name}`, (event) => this.setTrail(name, event.detail));
    this.listen("cc-world", (event) => this.setWorld(event.detail));
    this.listen("cc-ghost", (event) => this.setGhost(event.detail));
    let parts;
    try {
      parts = await import("nicegui-scene");
      this.renderer = new parts.THREE.WebGLRenderer({ canvas: this.$refs.canvas, antialias: true, alpha: true });
    } catch {
      this.note = NONE;
      return;
    }
    this.parts = parts;
    this.build(parts.THREE);
    this.seen = new ResizeObserver(() => this.resize());
    this.seen.observe(this.$el);
    this.inSight = new IntersectionObserver((seen) => this.show(seen[seen.length - 1].isIntersecting));
    this.inSight.observe(this.$el);
    this.move(this.latest);
    for (const name in this.trails) this.drawTrail(name);
    if (this.latestWorld) this.setWorld(this.latestWorld);
    window.ccScene = { place: (name, ghost) => this.place(name, ghost), trail: (name) => this.trails[name].points,
      drawn: () => this.drawn, visible: () => this.visible,
      world: () => (this.world ? this.world.group.children.map((object) => object.getWorldPosition(new parts.THREE.Vector3()).toArray()) : []) };
  },
  beforeUnmount() {
    for (const [name, handler] of this.handlers || []) window.removeEventListener(name, handler);
    this.seen?.disconnect();
    this.inSight?.disconnect();
    this.renderer?.dispose();
  },
  methods: {
    listen(name, handler) {
      (this.handlers ||= []).push([name, handler]);
      window.addEventListener(name, handler);
    },
    build(THREE) {
      const extent = this.robot.extent;
      this.ratio = Math.min(window.devicePixelRatio || 1, 2);
      this.scene = new THREE.Scene();
      this.scene.add(new THREE.HemisphereLight(0xffffff, 0xb8c2cf, 2.2));
      const sun = new THREE.DirectionalLight(0xffffff, 1.6);
      sun.position.set(-2, -3, 6);
      this.scene.add(sun);
      this.camera = new THREE.PerspectiveCamera(45, 1, 0.03 * extent, 200 * extent);
      this.camera.up.set(0, 0, 1);
      this.controls = new this.parts.OrbitControls(this.camera, this.renderer.domElement);
      this.controls.maxPolarAngle = Math.PI / 2;
      this.controls.addEventListener("start", () => (this.touched = true));
      this.controls.addEventListener("change", () => this.wake());
      this.aim(extent);
      this.addGrid(THREE, extent);
      this.base = new THREE.Group();
      this.scene.add(this.base);
      this.links = new Map([[this.robot.root, new THREE.Group()]]);
      this.shapes = new Map();
      this.base.add(this.links.get(this.robot.root));
      this.addVisuals(this.robot.root, this.robot.visuals);
      for (const joint of this.robot.joints) this.addJoint(THREE, joint);
      this.renderer.domElement.addEventListener("webglcontextlost", (event) => {
        event.preventDefault();
        this.note = "The browser has stopped drawing the 3D picture; it returns automatically, or when you reload the page.";
      });
      this.renderer.domElement.addEventListener("webglcontextrestored", () => {
        this.note = "";
        this.wake();
      });
    },
    aim(extent) {
      // camera behind the robot's left side, so that left and forward are as the driver sees them
      const { x, y } = this.base?.position || { x: 0, y: 0 };
      this.reach = extent;
      this.controls.minDistance = 0.5 * extent;
      this.controls.maxDistance = 60 * extent;
      this.camera.position.set(x - 2.9 * extent, y + 2.0 * extent, 2.2 * extent);
      this.controls.target.set(x, y, 0.25 * extent);
      this.controls.update();
    },
    aimAtMeshes() {
      const box = new this.parts.THREE.Box3().setFromObject(this.base), at = this.base.position;
      const reach = Math.max(...["x", "y", "z"].flatMap((axis) => [box.max[axis] - at[axis], at[axis] - box.min[axis]]));
      if (!this.touched && Number.isFinite(reach) && reach > 1.2 * this.reach) {
        this.scene.remove(this.grid);
        this.addGrid(this.parts.THREE, reach);
        this.grid.position.set(Math.round(at.x), Math.round(at.y), 0);
        Object.assign(this.camera, { near: 0.03 * reach, far: 200 * reach });
        this.camera.updateProjectionMatrix();
        this.aim(reach);
      }
    },
    addGrid(THREE, extent) {
      this.cell = extent < 1 ? 0.1 : 0.5;
      this.grid = new THREE.Group();
      const half = Math.ceil((12 * extent) / (10 * this.cell)) * 10 * this.cell, section = 10 * this.cell;
      // short pieces, because software renderers drop long lines that begin behind the camera
      const lines = (step, color, z) => {
        const points = [];
        for (let at = -half; at <= half + 1e-9; at += step) {
          for (let from = -half; from < half - 1e-9; from += section / 2) {
            points.push(at, from, z, at, from + section / 2, z, from, at, z, from + section / 2, at, z);
          }
        }
        const geometry = new THREE.BufferGeometry();
        geometry.setAttribute("position", new THREE.Float32BufferAttribute(points, 3));
        this.grid.add(new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ color })));
      };
      lines(this.cell, 0xd6dce4, -0.003);
      lines(section, 0xa9b5c4, -0.002);
      this.scene.add(this.grid);
      this.scene.fog = new THREE.Fog(0xf3f5f8, 8 * extent, 24 * extent);
    },
    addJoint(THREE, joint) {
      const link = new THREE.Group();
      link.name = joint.child;
      link.position.set(...joint.position);
      link.quaternion.copy(this.turn(joint.wxyz));
      (this.links.get(joint.parent) || this.base).add(link);
      this.links.set(joint.child, link);
      joint.rest = { position: link.position.clone(), turn: link.quaternion.clone() };
      joint.way = new THREE.Vector3(...joint.axis).normalize();
      this.addVisuals(joint.child, joint.visuals);
    },
    turn([w, x, y, z]) {
      return new this.parts.THREE.Quaternion(x, y, z, w);
    },
    addVisuals(link, visuals) {
      const THREE = this.parts.THREE;
      for (const visual of visuals) {
        const place = new THREE.Group();
        place.position.set(...visual.position);
        place.quaternion.copy(this.turn(visual.wxyz));
        this.links.get(link).add(place);
        const [red, green, blue] = visual.color.map((channel) => channel / 255);
        const color = new THREE.Color().setRGB(red, green, blue, THREE.SRGBColorSpace);
        const material = new THREE.MeshStandardMaterial({
          color, roughness: 0.65, metalness: 0.05, transparent: visual.opacity < 1, opacity: visual.opacity,
        });
        if (!this.shapes.has(link)) this.shapes.set(link, []);
        this.shapes.get(link).push({ material, color: color.clone() });
        if (visual.shape === "mesh") this.addMesh(place, visual, material);
        else place.add(new THREE.Mesh(this.geometry(THREE, visual), material));
      }
    },
    geometry(THREE, { shape, size }) {
      if (shape === "box") return new THREE.BoxGeometry(...size);
      if (shape === "sphere") return new THREE.SphereGeometry(size[0], 32, 20);
      return new THREE.CylinderGeometry(size[0], size[0], size[1], 48).rotateX(Math.PI / 2); // a URDF cylinder has its axis along z
    },
    worldGeometry(THREE, { shape, size }) {
      // the sizes are the lengths along the shape's axes
      if (shape === "cylinder") return new THREE.CylinderGeometry(0.5, 0.5, 1, 32).rotateX(Math.PI / 2).scale(...size);
      if (shape === "ellipsoid") return new THREE.SphereGeometry(0.5, 24, 16).scale(...size);
      return new THREE.BoxGeometry(...size);
    },
    worldMaterial(THREE, { shape, moves, robot, grip }) {
      if (shape === "patch") {
        const color = grip < USUAL ? LOW_FRICTION : HIGH_FRICTION;
        return new THREE.MeshStandardMaterial({ color, roughness: 0.9, transparent: true, opacity: 0.55 });
      }
      return new THREE.MeshStandardMaterial({ color: robot ? OTHER : moves ? MOVING : FIXED, roughness: 0.8 });
    },
    async addMesh(place, visual, material) {
      place.scale.set(...visual.size);
      try {
        if (visual.url.endsWith("glb")) {
          place.add((await new this.parts.GLTFLoader().loadAsync(visual.url)).scene);
        } else {
          const geometry = await new this.parts.STLLoader().loadAsync(visual.url);
          place.add(new this.parts.THREE.Mesh(geometry, material));
        }
      } catch (error) {
        console.warn(`mesh ${visual.url} is not drawn: ${error}`);
      }
      this.aimAtMeshes();
      this.wake();
    },
    move(news) {
      Object.assign(this.latest, news);
      if (!this.base) return;
      if (news.angles) this.moveJoints(news.angles, (name) => this.links.get(name));
      if (news.pose) this.moveBase(news.pose);
      if (news.truth !== undefined) this.setTruth(news.truth);
      if (news.tint) this.setTint(new Set(news.tint));
      this.wake();
    },
    setGhost(angles) {
      // preview: a transparent copy of the robot as it is drawn now
      if (!this.base) return;
      if (!angles && this.ghost) {
        this.base.parent.remove(this.ghost);
        this.ghost = null;
      } else if (angles) {
        if (!this.ghost) this.addGhost();
        this.moveJoints(angles, (name) => this.ghost.getObjectByName(name));
      }
      this.wake();
    },
    addGhost() {
      const material = new this.parts.THREE.MeshStandardMaterial(GHOST);
      this.ghost = this.base.clone();
      this.ghost.traverse((part) => part.isMesh && (part.material = material));
      this.scene.add(this.ghost);
    },
    moveJoints(angles, linkOf) {
      const THREE = this.parts.THREE;
      this.robot.joints.forEach((joint, number) => {
        const angle = angles[number];
        if (angle === null || angle === undefined) return;
        const link = linkOf(joint.child);
        if (joint.kind === "prismatic") {
          link.position.copy(joint.rest.position).add(joint.way.clone().multiplyScalar(angle).applyQuaternion(joint.rest.turn));
        } else if (joint.kind !== "fixed") {
          link.quaternion.copy(joint.rest.turn).multiply(new THREE.Quaternion().setFromAxisAngle(joint.way, angle));
        }
      });
    },
    moveBase([x, y, heading]) {
      const dx = x - this.base.position.x, dy = y - this.base.position.y;
      this.base.position.set(x, y, 0);
      this.base.rotation.z = heading;
      if (this.ghost) {
        this.ghost.position.copy(this.base.position);
        this.ghost.rotation.z = heading;
      }
      if (this.follow) this.shift(dx, dy);
      const section = 10 * this.cell;
      this.grid.position.set(Math.round(x / section) * section, Math.round(y / section) * section, 0);
      this.addToTrail("trail", x, y);
    },
    setTruth(pose) {
      // true pose of the base: a ring on the floor with a line ahead, next to the robot at its odometry pose
      if (pose && !this.truthMark) {
        const THREE = this.parts.THREE, size = 0.6 * this.robot.extent, points = [new THREE.Vector3(size, 0, 0)];
        for (let at = 0; at <= 48; at++) {
          points.push(new THREE.Vector3(size * Math.cos((at * Math.PI) / 24), size * Math.sin((at * Math.PI) / 24), 0));
        }
        points.push(new THREE.Vector3());
        const material = new THREE.LineBasicMaterial({ color: TRUE });
        this.truthMark = new THREE.Line(new THREE.BufferGeometry().setFromPoints(points), material);
        this.scene.add(this.truthMark);
      }
      if (this.truthMark) this.truthMark.visible = Boolean(pose);
      if (!pose) return;
      this.truthMark.position.set(pose[0], pose[1], 0.003);
      this.truthMark.rotation.z = pose[2];
      this.addToTrail("truth", pose[0], pose[1]);
    },
    setWorld(world) {
      // objects of the world, in the frame of the world
      this.latestWorld = world;
      if (!this.base) return;
      const THREE = this.parts.THREE, sizes = JSON.stringify(world.shapes.map(({ shape, size, grip }) => [shape, size, grip]));
      if (!this.world || this.world.sizes !== sizes) {
        if (this.world) this.scene.remove(this.world.group);
        this.world = { sizes, group: new THREE.Group() };
        for (const shape of world.shapes) {
          this.world.group.add(new THREE.Mesh(this.worldGeometry(THREE, shape), this.worldMaterial(THREE, shape)));
        }
        this.scene.add(this.world.group);
      }
      const [x, y, turn] = world.place;
      this.world.group.position.set(x, y, 0);
      this.world.group.rotation.z = turn;
      world.shapes.forEach((shape, number) => {
        this.world.group.children[number].position.set(...shape.position);
        this.world.group.children[number].quaternion.copy(this.turn(shape.wxyz));
      });
      this.wake();
    },
    shift(dx, dy) {
      this.camera.position.x += dx;
      this.camera.position.y += dy;
      this.controls.target.x += dx;
      this.controls.target.y += dy;
      this.camera.updateMatrixWorld();
    },
    setFollow(follow) {
      this.follow = follow;
      if (follow && this.controls) {
        this.shift(this.base.position.x - this.controls.target.x, this.base.position.y - this.controls.target.y);
        this.wake();
      }
    },
    setTint(joints) {
      for (const joint of this.robot.joints) {
        for (const { material, color } of this.shapes.get(joint.child) || []) {
          if (joints.has(joint.name)) material.color.setHex(FAULT);
          else material.color.copy(color);
        }
      }
    },
    setTrail(name, points) {
      this.trails[name].points = points;
      if (this.base) this.drawTrail(name);
    },
    addToTrail(name, x, y) {
      const { points } = this.trails[name];
      const last = points[points.length - 1] || [Infinity, Infinity];
      const moved = Math.hypot(x - last[0], y - last[1]);
      if (moved < 0.01) return;
      if (points.length && moved > 1) points.length = 0;
      points.push([x, y]);
      if (points.length > MOST_POINTS) points.shift();
      this.drawTrail(name);
    },
    drawTrail(name) {
      // the path grows many times a second, so that points are appended in place
      const THREE = this.parts.THREE, trail = this.trails[name];
      if (!trail.line) {
        const geometry = new THREE.BufferGeometry();
        geometry.setAttribute("position", new THREE.Float32BufferAttribute(new Float32Array(3 * MOST_POINTS), 3));
        trail.line = new THREE.Line(geometry, new THREE.LineBasicMaterial({ color: trail.color }));
        trail.line.frustumCulled = false;
        this.scene.add(trail.line);
      }
      const places = trail.line.geometry.getAttribute("position"), points = trail.points.slice(-MOST_POINTS);
      points.forEach(([x, y], number) => places.setXYZ(number, x, y, 0.002));
      places.needsUpdate = true;
      trail.line.geometry.setDrawRange(0, points.length);
    },
    place(name, ghost = false) {
      const drawn = ghost ? this.ghost?.getObjectByName(name) : this.links?.get(name);
      const object = name === "base" ? this.base : drawn;
      if (!object) return null;
      object.updateWorldMatrix(true, false);
      return object.matrixWorld.elements.slice();
    },
    resize() {
      const { clientWidth: width, clientHeight: height } = this.$el;
      if (!width || !height) return;
      this.renderer.setPixelRatio(this.ratio);
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
      this.wake();
    },
    show(visible) {
      // nothing is drawn while the scene is scrolled out of view; changes are drawn when it is visible again
      this.visible = visible;
      if (visible && this.missed) this.wake();
    },
    wake() {
      this.missed = !this.visible;
      if (this.waking || this.missed) return;
      this.waking = true;
      requestAnimationFrame(() => this.draw());
    },
    draw() {
      this.waking = false;
      this.drawn += 1;
      const begin = performance.now();
      this.renderer.render(this.scene, this.camera);
      if (this.frames === undefined || this.ratio > LEAST_RATIO) this.adaptResolution(performance.now() - begin);
    },
    adaptResolution(duration) {
      this.frames = (this.frames || 0) + 1;
      this.slow = duration > SLOW_MS && this.frames > 2 ? (this.slow || 0) + 1 : 0;
      if (this.slow < 4) return;
      this.slow = 0;
      this.ratio = Math.max(LEAST_RATIO, this.ratio * 0.75);
      this.resize();
    },
  },
};
