// What is seen of a recording, in WebGL: a mesh for each body, the floor with its cells, and the shadow of the sun.

import {
  add,
  boxShape,
  cross,
  floorShape,
  looking,
  multiplied,
  normalized,
  orthographic,
  perspective,
  placing,
  scaled,
  subtract,
  transformed,
} from "./geometry.js";

const SUN = normalized([-0.42, -0.38, 1.0]);
const SHADOW_PIXELS = 2048;
const ASPECT = 16 / 9; // of the picture that the recording's camera fills
const CAR = /^car(\d+)\/board$/;

const VERTEX = `#version 300 es
in vec3 point;
in vec3 normal;
in vec4 colour;
uniform mat4 place;
uniform mat4 view;
uniform mat4 sunView;
uniform vec4 paint;
out vec3 worldPoint;
out vec3 worldNormal;
out vec4 faceColour;
out vec4 sunPoint;
void main() {
  vec4 world = place * vec4(point, 1.0);
  worldPoint = world.xyz;
  worldNormal = mat3(place) * normal;
  faceColour = paint.a > 0.0 ? paint : colour;
  sunPoint = sunView * vec4(world.xyz + 0.004 * normalize(worldNormal), 1.0);
  gl_Position = view * world;
}`;

const FRAGMENT = `#version 300 es
precision highp float;
precision highp sampler2DShadow;
in vec3 worldPoint;
in vec3 worldNormal;
in vec4 faceColour;
in vec4 sunPoint;
uniform sampler2DShadow shadow;
uniform vec3 sun;
uniform vec3 eye;
uniform vec2 cell;
uniform vec2 area;
uniform vec3 floorColour;
uniform vec3 areaColour;
uniform vec3 lineColour;
uniform vec3 skyColour;
uniform bool isFloor;
out vec4 pixel;

float sunlight() {
  vec3 at = sunPoint.xyz / sunPoint.w * 0.5 + 0.5;
  if (any(lessThan(at, vec3(0.0))) || any(greaterThan(at, vec3(1.0)))) return 1.0;
  float sum = 0.0;
  for (int x = -1; x <= 1; x++) {
    for (int y = -1; y <= 1; y++) {
      vec2 beside = vec2(x, y) / ${SHADOW_PIXELS.toFixed(1)};
      sum += texture(shadow, vec3(at.xy + beside, at.z - 0.0006));
    }
  }
  return sum / 9.0;
}

vec3 floorAt(vec2 place) {
  vec2 n = place / cell;
  bool inside = all(greaterThan(n, vec2(0.0))) && all(lessThan(n, area));
  vec2 width = max(fwidth(n), vec2(1e-4));
  vec2 apart = abs(n - round(n));
  vec2 line = 1.0 - smoothstep(0.006 + 0.5 * width, 0.006 + 1.5 * width, apart);
  bool atEdge = all(greaterThan(n, vec2(-0.01))) && all(lessThan(n, area + 0.01));
  vec3 colour = inside ? areaColour : floorColour;
  return atEdge ? mix(colour, lineColour, max(line.x, line.y)) : colour;
}

void main() {
  vec3 up = normalize(worldNormal);
  vec3 base = faceColour.rgb;
  if (isFloor) {
    base = floorAt(worldPoint.xy);
    vec3 lit = base * (0.72 + 0.28 * sunlight());
    float far = smoothstep(4.0, 18.0, distance(worldPoint, eye));
    pixel = vec4(mix(lit, skyColour, far), 1.0);
    return;
  }
  float towards = max(dot(up, sun), 0.0);
  float open = 0.5 + 0.5 * up.z;
  vec3 back = normalize(eye - worldPoint);
  float shine = 0.12 * pow(max(dot(reflect(-sun, up), back), 0.0), 24.0);
  float direct = towards > 0.0 ? towards * sunlight() : 0.0;
  vec3 lit = base * (0.34 + 0.26 * open + 0.52 * direct) + shine * direct;
  pixel = vec4(lit, faceColour.a);
}`;

const SHADOW_VERTEX = `#version 300 es
in vec3 point;
uniform mat4 place;
uniform mat4 sunView;
void main() { gl_Position = sunView * place * vec4(point, 1.0); }`;

const SHADOW_FRAGMENT = `#version 300 es
precision mediump float;
void main() {}`;

/** Colours of the surroundings, for light and dark pages: red, green and blue of 0 to 1. */
const LOOKS = {
  light: {
    sky: [0.93, 0.94, 0.95],
    floor: [0.9, 0.9, 0.89],
    area: [0.99, 0.99, 0.98],
    line: [0.74, 0.76, 0.78],
  },
  dark: {
    sky: [0.09, 0.1, 0.11],
    floor: [0.14, 0.15, 0.16],
    area: [0.23, 0.24, 0.25],
    line: [0.38, 0.4, 0.42],
  },
};

/** A picture of a world that is drawn anew for each pose of its bodies. */
export class Scene {
  /** Make the picture of a recording on a canvas. Throws Error where there is no WebGL 2. */
  constructor(canvas, recording) {
    this.canvas = canvas;
    this.recording = recording;
    this.gl = canvas.getContext("webgl2", { alpha: false, antialias: true });
    if (!this.gl) throw new Error("this browser has no WebGL 2");
    this.camera = structuredClone(recording.camera);
    this.program = compiled(this.gl, VERTEX, FRAGMENT);
    this.shadowProgram = compiled(this.gl, SHADOW_VERTEX, SHADOW_FRAGMENT);
    this.meshes = recording.shapes.map((shape) => this.meshOf(shape, recording.units));
    this.floor = this.meshOf(floorShape(), { points_m: 1, normals: 1 });
    this.box = this.meshOf(boxShape(), { points_m: 1, normals: 1 });
    this.makeShadowMap();
  }

  /** Draw bodies at their poses; marks are boxes {pos, quat, half, colour} beside them. */
  draw(poses, marks, look) {
    const gl = this.gl;
    this.fitCanvas();
    const colours = LOOKS[look];
    const things = [];
    this.recording.bodies.forEach((body, number) => {
      if (body.shape === undefined) return;
      const pose = poses[number];
      things.push({ mesh: this.meshes[body.shape], place: placing(pose.pos, pose.quat) });
    });
    this.drawShadowMap(things);
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.clearColor(...colours.sky, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.useProgram(this.program.id);
    const set = this.program.uniforms;
    const { eye, matrix } = this.view();
    const [length, width] = this.recording.cells;
    gl.uniformMatrix4fv(set.view, false, matrix);
    gl.uniformMatrix4fv(set.sunView, false, this.sunView);
    gl.uniform3fv(set.sun, SUN);
    gl.uniform3fv(set.eye, eye);
    gl.uniform2fv(set.cell, this.recording.cell_m.slice(0, 2));
    gl.uniform2fv(set.area, [length, width]);
    gl.uniform3fv(set.floorColour, colours.floor);
    gl.uniform3fv(set.areaColour, colours.area);
    gl.uniform3fv(set.lineColour, colours.line);
    gl.uniform3fv(set.skyColour, colours.sky);
    gl.uniform1i(set.shadow, 0);
    gl.uniform1i(set.isFloor, 1);
    gl.uniform4f(set.paint, 0, 0, 0, 0);
    this.drawMesh(this.program, this.floor, placing([0, 0, 0], [1, 0, 0, 0]));
    gl.uniform1i(set.isFloor, 0);
    for (const thing of things) this.drawMesh(this.program, thing.mesh, thing.place);
    for (const mark of marks) {
      // Contacts lie inside of what touches; they are seen through it.
      if (mark.through) gl.disable(gl.DEPTH_TEST);
      else gl.enable(gl.DEPTH_TEST);
      gl.uniform4fv(set.paint, mark.colour);
      this.drawMesh(this.program, this.box, placing(mark.pos, mark.quat, mark.half));
    }
  }

  /** Return where cars' numbers belong on the canvas: {car, x, y} in CSS pixels. */
  labels(poses) {
    const { matrix } = this.view();
    const labels = [];
    this.recording.bodies.forEach((body, number) => {
      const car = CAR.exec(body.name);
      if (!car) return;
      const [x, y, , w] = transformed(matrix, [...add(poses[number].pos, [0, 0, 0.03]), 1]);
      labels.push({
        car: Number(car[1]),
        x: (0.5 + (0.5 * x) / w) * this.canvas.clientWidth,
        y: (0.5 - (0.5 * y) / w) * this.canvas.clientHeight,
      });
    });
    return labels;
  }

  /** Return the ray {eye, direction} through a place on the canvas, in CSS pixels from its corner. */
  rayThrough(x, y) {
    const { eye, axes, tangent } = this.view();
    const across = (2 * x) / this.canvas.clientWidth - 1;
    const up = 1 - (2 * y) / this.canvas.clientHeight;
    const aspect = this.canvas.clientWidth / this.canvas.clientHeight;
    const sideways = scaled(axes.right, across * tangent * aspect);
    const upwards = scaled(axes.up, up * tangent);
    return { eye, direction: normalized(add(add(axes.forward, sideways), upwards)) };
  }

  turn(azimuthDeg, elevationDeg) {
    this.camera.azimuth_deg += azimuthDeg;
    const elevation = this.camera.elevation_deg + elevationDeg;
    this.camera.elevation_deg = Math.min(-3, Math.max(-89.5, elevation));
  }

  /** Move the camera's target by parts of the canvas's height. */
  shift(across, up) {
    const { axes, tangent, distance } = this.view();
    const height = 2 * tangent * distance;
    const target = add(this.camera.target, scaled(axes.right, across * height));
    this.camera.target = add(target, scaled(axes.up, up * height));
  }

  zoom(factor) {
    this.camera.distance_m = Math.min(30, Math.max(0.3, this.camera.distance_m * factor));
  }

  view() {
    const { target, azimuth_deg, elevation_deg, fovy_deg } = this.camera;
    const azimuth = (azimuth_deg * Math.PI) / 180;
    const elevation = (elevation_deg * Math.PI) / 180;
    const flat = Math.cos(elevation);
    const forward = [flat * Math.cos(azimuth), flat * Math.sin(azimuth), Math.sin(elevation)];
    const right = [Math.sin(azimuth), -Math.cos(azimuth), 0];
    const up = cross(right, forward);
    const aspect = this.canvas.width / this.canvas.height;
    // A picture that is less wide sees as much to the sides from further away.
    const distance = this.camera.distance_m * Math.max(1, ASPECT / aspect);
    const eye = subtract(target, scaled(forward, distance));
    const tangent = Math.tan((fovy_deg * Math.PI) / 360);
    const seen = looking(eye, right, up, forward);
    const matrix = multiplied(perspective(tangent, aspect), seen);
    return { eye, matrix, axes: { right, up, forward }, tangent, distance };
  }

  /** Give back what the browser holds for the picture. */
  close() {
    this.gl.getExtension("WEBGL_lose_context")?.loseContext();
  }

  fitCanvas() {
    const scale = Math.min(window.devicePixelRatio || 1, 2);
    const width = Math.max(1, Math.round(this.canvas.clientWidth * scale));
    const height = Math.max(1, Math.round(this.canvas.clientHeight * scale));
    if (this.canvas.width !== width || this.canvas.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
    }
  }

  meshOf(shape, units) {
    const gl = this.gl;
    const n = shape.faces.length;
    const numbers = new Float32Array(10 * n);
    for (let i = 0; i < n; i++) {
      const corner = 3 * shape.faces[i];
      const colour = shape.palette[shape.colours[Math.floor(i / 3)]];
      for (let axis = 0; axis < 3; axis++) {
        numbers[10 * i + axis] = shape.points_m[corner + axis] * units.points_m;
        numbers[10 * i + 3 + axis] = shape.normals[corner + axis] * units.normals;
      }
      for (let part = 0; part < 4; part++) numbers[10 * i + 6 + part] = colour[part] / 255;
    }
    const buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, numbers, gl.STATIC_DRAW);
    return { buffer, n };
  }

  drawMesh(program, mesh, place) {
    const gl = this.gl;
    gl.bindBuffer(gl.ARRAY_BUFFER, mesh.buffer);
    const parts = [
      ["point", 3, 0],
      ["normal", 3, 12],
      ["colour", 4, 24],
    ];
    for (const [name, size, offset] of parts) {
      const at = program.attributes[name];
      if (at === undefined) continue;
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, size, gl.FLOAT, false, 40, offset);
    }
    gl.uniformMatrix4fv(program.uniforms.place, false, place);
    gl.drawArrays(gl.TRIANGLES, 0, mesh.n);
  }

  makeShadowMap() {
    const gl = this.gl;
    this.shadowMap = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.shadowMap);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.DEPTH_COMPONENT24, SHADOW_PIXELS, SHADOW_PIXELS);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_COMPARE_MODE, gl.COMPARE_REF_TO_TEXTURE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    this.shadowTarget = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.shadowTarget);
    const depth = gl.DEPTH_ATTACHMENT;
    gl.framebufferTexture2D(gl.FRAMEBUFFER, depth, gl.TEXTURE_2D, this.shadowMap, 0);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    const [length, width, height] = this.recording.cells.map(
      (n, i) => n * this.recording.cell_m[i],
    );
    const radius = 0.5 * Math.hypot(length, width, height) + 0.4;
    const middle = [length / 2, width / 2, height / 2];
    const right = normalized(cross(SUN, [0, 0, 1]));
    const up = cross(SUN, right).map((part) => -part);
    const eye = add(middle, scaled(SUN, 2 * radius));
    const seen = looking(eye, right, up, scaled(SUN, -1));
    this.sunView = multiplied(orthographic(radius, 4 * radius), seen);
  }

  drawShadowMap(things) {
    const gl = this.gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.shadowTarget);
    gl.viewport(0, 0, SHADOW_PIXELS, SHADOW_PIXELS);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.useProgram(this.shadowProgram.id);
    gl.uniformMatrix4fv(this.shadowProgram.uniforms.sunView, false, this.sunView);
    for (const thing of things) this.drawMesh(this.shadowProgram, thing.mesh, thing.place);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }
}

function compiled(gl, vertex, fragment) {
  const id = gl.createProgram();
  for (const [kind, text] of [
    [gl.VERTEX_SHADER, vertex],
    [gl.FRAGMENT_SHADER, fragment],
  ]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(id, shader);
  }
  gl.linkProgram(id);
  if (!gl.getProgramParameter(id, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(id));
  const uniforms = {};
  for (let i = 0; i < gl.getProgramParameter(id, gl.ACTIVE_UNIFORMS); i++) {
    const { name } = gl.getActiveUniform(id, i);
    uniforms[name] = gl.getUniformLocation(id, name);
  }
  const attributes = {};
  for (let i = 0; i < gl.getProgramParameter(id, gl.ACTIVE_ATTRIBUTES); i++) {
    const { name } = gl.getActiveAttrib(id, i);
    attributes[name] = gl.getAttribLocation(id, name);
  }
  return { id, uniforms, attributes };
}
