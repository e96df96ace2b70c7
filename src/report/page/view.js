"use strict";
// The view that turns: WebGL 2 and nothing else. The scene is quantized to 16 bits a coordinate in a cube of side 1; the camera, the light and
// the colours are those of the pictures (src/picture), so that both show the same.
(() => {
  const at = (id) => document.getElementById(id);
  const scene = JSON.parse(at("scene").textContent);
  const canvas = at("canvas");
  const gl = canvas.getContext("webgl2", { antialias: true, alpha: false });
  if (!gl) return;

  // How far the eye is from the centre, in radii; the first view in radians.
  const DISTANCE = 4.5;
  const FIRST = { yaw: Math.atan2(0.55, 1), pitch: Math.atan2(0.4, Math.hypot(1, 0.55)) };
  const MARGIN = 0.06;
  // Bytes of a vertex: position, value and octahedral normal, 16 bits each.
  const STRIDE = 12;
  const LINE_WIDTH = 1.3;
  // Of an edge of the cage, by whether something is in front of it.
  const FAINT = 0.05, CLEAR = 0.5;
  const POINT_SIZE = 2;

  const PROJECTION = `#version 300 es
    precision highp float;
    uniform mat3 u_axes;      // right, up and towards the eye, as rows
    uniform vec3 u_center;
    uniform float u_radius;
    uniform vec2 u_scale;     // to clip coordinates at the depth of the centre
    uniform vec2 u_offset;
    vec4 project(vec3 p) {
      vec3 local = u_axes * (p - u_center);
      float eye = ${DISTANCE.toFixed(1)} * u_radius;
      float far = eye + 1.05 * u_radius, near = eye - 1.05 * u_radius;
      float w = eye - local.z;
      float z = ((far + near) * w - 2.0 * far * near) / (far - near);
      return vec4(eye * u_scale * local.xy + w * u_offset, z, w);
    }`;
  const LIGHT = `#version 300 es
    precision highp float;
    out vec4 o_color;
    vec3 encoded(vec3 light) {
      vec3 x = clamp(light, 0.0, 1.0);
      return mix(12.92 * x, 1.055 * pow(x, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, x));
    }
    vec3 lit(vec3 color, vec3 normal) {
      vec3 lamp = vec3(-0.35, 0.55, 0.758), halfway = vec3(-0.187, 0.293, 0.938);
      float diffuse = 0.15 + 0.1 * (1.0 + normal.y) + 0.7 * max(dot(normal, lamp), 0.0);
      return color * diffuse + 0.06 * pow(max(dot(normal, halfway), 0.0), 32.0);
    }`;

  const surfaces = program(
    `${PROJECTION}
    uniform float u_point;
    layout(location = 0) in vec3 a_position;
    layout(location = 1) in float a_value;
    layout(location = 2) in vec2 a_normal;
    out vec3 v_normal;
    out float v_value;
    void main() {
      vec2 octahedral = 2.0 * a_normal - 1.0;
      vec3 n = vec3(octahedral, 1.0 - abs(octahedral.x) - abs(octahedral.y));
      float under = max(-n.z, 0.0);
      n.xy -= under * vec2(n.x >= 0.0 ? 1.0 : -1.0, n.y >= 0.0 ? 1.0 : -1.0);
      v_normal = u_axes * n;
      v_value = 2.0 * a_value - 1.0;
      gl_Position = project(a_position);
      gl_PointSize = u_point;
    }`,
    `${LIGHT}
    uniform vec3 u_color;
    uniform vec3 u_unknown;
    uniform bool u_valued;
    uniform bool u_points;
    uniform sampler2D u_map;
    in vec3 v_normal;
    in float v_value;
    void main() {
      vec3 color = u_color;
      if (u_valued) {
        color = v_value < -1e-4 ? u_unknown : texture(u_map, vec2((clamp(v_value, 0.0, 1.0) * 255.0 + 0.5) / 256.0, 0.5)).rgb;
      }
      vec3 normal = u_points ? vec3(-0.187, 0.293, 0.938) : normalize(v_normal);
      if (!gl_FrontFacing && !u_points) {
        color *= vec3(0.62, 0.55, 0.5);
        normal = -normal;
      }
      o_color = vec4(encoded(lit(color, normal)), 1.0);
    }`);
  const lines = program(
    `${PROJECTION}
    uniform vec2 u_pixel;     // a pixel in clip coordinates
    uniform float u_width;
    layout(location = 0) in vec3 a_from;
    layout(location = 1) in vec3 a_to;
    void main() {
      vec4 from = project(a_from), to = project(a_to);
      vec2 along = (to.xy / to.w - from.xy / from.w) / u_pixel;
      along = along == vec2(0.0) ? vec2(1.0, 0.0) : normalize(along);
      vec4 end = (gl_VertexID & 1) == 0 ? from : to;
      float side = gl_VertexID < 2 ? -1.0 : 1.0;
      // Beyond its ends by as much as it is wide, so that bends have no gaps and what has no length is a square.
      vec2 beyond = 0.5 * u_width * ((gl_VertexID & 1) == 0 ? -1.0 : 1.0) * along * u_pixel;
      vec2 aside = 0.5 * u_width * side * vec2(-along.y, along.x) * u_pixel;
      gl_Position = vec4(end.xy + (beyond + aside) * end.w, end.z - 0.004 * end.w, end.w);
    }`,
    `#version 300 es
    precision highp float;
    uniform vec4 u_color;
    out vec4 o_color;
    void main() { o_color = u_color; }`);

  const layers = Object.fromEntries(Object.entries(scene.layers).map(([name, layer]) => [name, upload(layer)]));
  const features = scene.features.map((sort) => ({
    box: offer(sort),
    color: sort.color.map((byte) => byte / 255),
    lines: sort.lines.map(({ width, ends }) => ({ width, ...uploadEnds(bytes(ends)) })),
  }));
  const map = colorMap(scene.colors);
  const radius = 0.5 * Math.hypot(...scene.extent);
  const center = scene.extent.map((x) => 0.5 * x);
  const view = {};
  let asked = false;

  at("pictures").hidden = true;
  for (const id of ["canvas", "tools", "hint"]) at(id).hidden = false;
  at("with-features").hidden = features.length === 0;
  document.querySelector(`[name=up][value=${scene.up}]`).checked = true;
  reset();
  listen();

  function program(vertex, fragment) {
    const made = gl.createProgram();
    for (const [type, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS)) {
      const logs = gl.getAttachedShaders(made).map((shader) => gl.getShaderInfoLog(shader));
      throw new Error([gl.getProgramInfoLog(made), ...logs].join("\n"));
    }
    const uniform = (name) => gl.getUniformLocation(made, name);
    return { made, uniform };
  }

  function bytes(base64) {
    const text = atob(base64);
    const bytes = new Uint8Array(text.length);
    for (let k = 0; k < text.length; k++) bytes[k] = text.charCodeAt(k);
    return bytes;
  }

  function buffer(target, data) {
    const made = gl.createBuffer();
    gl.bindBuffer(target, made);
    gl.bufferData(target, data, gl.STATIC_DRAW);
  }

  function upload(layer) {
    const vertices = bytes(layer.vertices);
    const result = { ...layer, words: new Uint16Array(vertices.buffer), array: gl.createVertexArray() };
    gl.bindVertexArray(result.array);
    buffer(gl.ARRAY_BUFFER, vertices);
    buffer(gl.ELEMENT_ARRAY_BUFFER, bytes(layer.indices));
    for (const [location, size, offset] of [[0, 3, 0], [1, 1, 6], [2, 2, 8]]) {
      gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, size, gl.UNSIGNED_SHORT, true, STRIDE, offset);
    }
    if (layer.edges) result.lines = uploadLines(bytes(layer.edges), result.words);
    gl.bindVertexArray(null);
    return result;
  }

  // Every edge is an instance with its two ends.
  function uploadLines(edges, words) {
    const corners = new Uint32Array(edges.buffer);
    const ends = new Uint16Array(4 * corners.length);
    corners.forEach((vertex, k) => {
      for (let i = 0; i < 3; i++) ends[4 * k + i] = words[vertex * STRIDE / 2 + i];
    });
    return uploadEnds(ends);
  }

  function uploadEnds(ends) {
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    buffer(gl.ARRAY_BUFFER, ends);
    for (const location of [0, 1]) {
      gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, 3, gl.UNSIGNED_SHORT, true, 16, 8 * location);
      gl.vertexAttribDivisor(location, 1);
    }
    gl.bindVertexArray(null);
    return { array, count: ends.byteLength / 16 };
  }

  // A box to tick for a sort of features.
  function offer({ name, color }) {
    const [label, box, sample] = ["label", "input", "i"].map((tag) => document.createElement(tag));
    Object.assign(box, { type: "checkbox", checked: true });
    sample.style.background = `rgb(${color})`;
    label.append(box, sample, ` ${name}`);
    at("features").append(label);
    return box;
  }

  function colorMap(base64) {
    const texture = gl.createTexture();
    const colors = bytes(base64);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.SRGB8, colors.length / 3, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, colors);
    for (const [key, value] of [
      [gl.TEXTURE_MIN_FILTER, gl.LINEAR], [gl.TEXTURE_MAG_FILTER, gl.LINEAR],
      [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
    ]) gl.texParameteri(gl.TEXTURE_2D, key, value);
    return texture;
  }

  function linear(rgb) {
    return rgb.map((byte) => (byte <= 10 ? byte / 255 / 12.92 : ((byte / 255 + 0.055) / 1.055) ** 2.4));
  }

  // The colour of a CSS property, from 0 to 1.
  function styled(property) {
    return getComputedStyle(canvas)[property].match(/[\d.]+/g).slice(0, 3).map((x) => x / 255);
  }

  // Right, up and towards the eye.
  function axes() {
    const up = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1] }[view.up];
    const side = view.up === "x" ? [0, 1, 0] : [1, 0, 0];
    const front = cross(side, up);
    const sum = (...terms) => [0, 1, 2].map((i) => terms.reduce((total, [factor, v]) => total + factor * v[i], 0));
    const { sin, cos } = Math;
    const right = sum([cos(view.yaw), side], [-sin(view.yaw), front]);
    const back = sum([cos(view.pitch) * sin(view.yaw), side], [cos(view.pitch) * cos(view.yaw), front], [sin(view.pitch), up]);
    return [right, cross(back, right), back];
  }

  function cross(a, b) {
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  }

  function reset() {
    Object.assign(view, FIRST, { up: document.querySelector("[name=up]:checked").value, zoom: 1, x: 0, y: 0 });
    frame();
    redraw();
  }

  // Makes all of the scan and the surface fit at zoom 1, as the pictures do.
  function frame() {
    const [right, up, back] = axes();
    const box = [Infinity, Infinity, -Infinity, -Infinity];
    const dot = (a, x, y, z) => a[0] * x + a[1] * y + a[2] * z;
    for (const { words } of Object.values(layers)) {
      for (let k = 0; k < words.length; k += STRIDE / 2) {
        const [x, y, z] = [0, 1, 2].map((i) => words[k + i] / 65535 - center[i]);
        const nearness = (DISTANCE * radius) / (DISTANCE * radius - dot(back, x, y, z));
        const [u, v] = [nearness * dot(right, x, y, z), nearness * dot(up, x, y, z)];
        box[0] = Math.min(box[0], u); box[1] = Math.min(box[1], v);
        box[2] = Math.max(box[2], u); box[3] = Math.max(box[3], v);
      }
    }
    view.box = box;
  }

  // Pixels to a unit of length, and where the centre is, in pixels from the middle with y upwards.
  function placement() {
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    const [left, bottom, right, top] = view.box;
    const room = 1 - 2 * MARGIN;
    const fit = Math.min((room * width) / (right - left), (room * height) / (top - bottom));
    const scale = fit * view.zoom;
    return { width, height, scale, x: view.x - (scale * (left + right)) / 2, y: view.y - (scale * (bottom + top)) / 2 };
  }

  function redraw() {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => { asked = false; draw(); });
  }

  function draw() {
    const ratio = window.devicePixelRatio || 1;
    const place = placement();
    canvas.width = Math.max(1, Math.round(place.width * ratio));
    canvas.height = Math.max(1, Math.round(place.height * ratio));
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(...styled("backgroundColor"), 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LESS);
    const shown = (name) => at(`show-${name}`).checked;
    const solid = ["surface", "target"].filter(shown);
    // A cage alone has faces; around something it is only its edges.
    const names = solid.length === 0 && shown("cage") ? ["cage"] : solid;
    use(surfaces, place);
    const { uniform } = surfaces;
    gl.uniform3fv(uniform("u_unknown"), linear(scene.unknown));
    gl.uniform1f(uniform("u_point"), POINT_SIZE * ratio);
    gl.bindTexture(gl.TEXTURE_2D, map);
    let triangles = 0;
    for (const layer of names.map((name) => layers[name])) {
      gl.bindVertexArray(layer.array);
      gl.uniform3fv(uniform("u_color"), linear(layer.color));
      gl.uniform1i(uniform("u_valued"), layer.valued);
      gl.uniform1i(uniform("u_points"), layer.triangles === 0);
      if (layer.triangles) gl.drawElements(gl.TRIANGLES, 3 * layer.triangles, gl.UNSIGNED_INT, 0);
      else gl.drawArrays(gl.POINTS, 0, layer.vertex_count);
      triangles += layer.triangles;
    }
    if (shown("cage")) drawLines({ width: LINE_WIDTH, ...layers.cage.lines }, styled("color"), [FAINT, CLEAR], place, ratio);
    let lineCount = 0;
    at("features").hidden = !shown("features");
    for (const { color, lines } of features.filter(({ box }) => shown("features") && box.checked)) {
      for (const some of lines) {
        drawLines(some, color, [0, 1], place, ratio);
        lineCount += some.count;
      }
    }
    gl.bindVertexArray(null);
    const legend = at("legend");
    if (legend) legend.hidden = !shown("surface");
    canvas.dataset.triangles = triangles;
    canvas.dataset.features = lineCount;
  }

  function use({ made, uniform }, place) {
    gl.useProgram(made);
    gl.uniformMatrix3fv(uniform("u_axes"), true, axes().flat());
    gl.uniform3fv(uniform("u_center"), center);
    gl.uniform1f(uniform("u_radius"), radius);
    gl.uniform2f(uniform("u_scale"), (2 * place.scale) / place.width, (2 * place.scale) / place.height);
    gl.uniform2f(uniform("u_offset"), (2 * place.x) / place.width, (2 * place.y) / place.height);
  }

  // `alphas`: of what is hidden and of what is not.
  function drawLines({ array, count, width }, color, alphas, place, ratio) {
    use(lines, place);
    const { uniform } = lines;
    gl.uniform2f(uniform("u_pixel"), 2 / canvas.width, 2 / canvas.height);
    gl.uniform1f(uniform("u_width"), width * ratio);
    gl.bindVertexArray(array);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.depthMask(false);
    for (const [k, compare] of [gl.GREATER, gl.LEQUAL].entries()) {
      gl.depthFunc(compare);
      gl.uniform4f(uniform("u_color"), ...color, alphas[k]);
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, count);
    }
    gl.depthMask(true);
    gl.disable(gl.BLEND);
  }

  function turn(across, down) {
    view.yaw -= across;
    view.pitch = Math.min(Math.max(view.pitch + down, -Math.PI / 2), Math.PI / 2);
    redraw();
  }

  // Zooms about a place, in pixels from the middle with y upwards.
  function zoom(factor, x, y) {
    const before = view.zoom;
    view.zoom = Math.min(Math.max(before * factor, 0.2), 200);
    view.x = x + ((view.x - x) * view.zoom) / before;
    view.y = y + ((view.y - y) * view.zoom) / before;
    redraw();
  }

  function listen() {
    const fromMiddle = (event) => {
      const box = canvas.getBoundingClientRect();
      return [event.clientX - box.left - box.width / 2, box.top + box.height / 2 - event.clientY];
    };
    const pointers = new Map();
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, fromMiddle(event));
    });
    for (const end of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(end, (event) => pointers.delete(event.pointerId));
    }
    canvas.addEventListener("pointermove", (event) => {
      const last = pointers.get(event.pointerId);
      if (!last) return;
      const now = fromMiddle(event);
      const [dx, dy] = [now[0] - last[0], now[1] - last[1]];
      const other = [...pointers].find(([id]) => id !== event.pointerId);
      if (other) {
        const apart = (p) => Math.max(Math.hypot(p[0] - other[1][0], p[1] - other[1][1]), 1);
        view.x += dx / 2;
        view.y += dy / 2;
        zoom(apart(now) / apart(last), ...other[1]);
      } else if (event.shiftKey || event.buttons & 6) {
        view.x += dx;
        view.y += dy;
        redraw();
      } else {
        turn(dx * 0.008, -dy * 0.008);
      }
      pointers.set(event.pointerId, now);
    });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      zoom(Math.exp(-0.0015 * event.deltaY * (event.deltaMode ? 20 : 1)), ...fromMiddle(event));
    }, { passive: false });
    canvas.addEventListener("dblclick", reset);
    const keys = {
      ArrowLeft: () => turn(-0.1, 0), ArrowRight: () => turn(0.1, 0), ArrowUp: () => turn(0, -0.1), ArrowDown: () => turn(0, 0.1),
      "+": () => zoom(1.2, 0, 0), "-": () => zoom(1 / 1.2, 0, 0), 0: reset,
    };
    canvas.addEventListener("keydown", (event) => {
      if (!keys[event.key]) return;
      event.preventDefault();
      keys[event.key]();
    });
    at("tools").addEventListener("change", (event) => (event.target.name === "up" ? reset() : redraw()));
    at("reset").addEventListener("click", reset);
    at("save").addEventListener("click", () => {
      draw();
      const link = document.createElement("a");
      link.download = "view.png";
      link.href = canvas.toDataURL("image/png");
      link.click();
    });
    new ResizeObserver(redraw).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
    canvas.addEventListener("webglcontextlost", () => {
      at("pictures").hidden = false;
      for (const id of ["canvas", "tools", "hint"]) at(id).hidden = true;
    });
  }
})();
