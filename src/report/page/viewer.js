// The 3D view: surface by patch, skewness, deviation or curvature; a cut through the volume mesh; worst elements.
(async () => {
  const host = document.getElementById('view');
  const meta = JSON.parse(document.getElementById('mesh-meta').textContent);
  const unpack = async (id, Type) => {
    const el = document.getElementById(id);
    if (!el) return null;
    const bytes = Uint8Array.from(atob(el.textContent.trim()), c => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('deflate'));
    return new Type(await new Response(stream).arrayBuffer());
  };
  const points = await unpack('mesh-points', Float32Array), triangles = await unpack('mesh-triangles', Uint32Array);
  const patch = await unpack('mesh-patch', Uint8Array), skew = await unpack('mesh-skewness', Float32Array);
  const deviation = await unpack('mesh-deviation', Float32Array), curvature = await unpack('mesh-curvature', Float32Array);
  const tetPoints = await unpack('tet-points', Float32Array), tets = await unpack('tet-cells', Uint32Array), sv = await unpack('tet-skewness', Float32Array);
  const lines = await unpack('center-lines', Float32Array);

  // Colour maps that survive colour blindness: viridis and a blue-white-orange.
  const viridis = [[68,1,84],[72,40,120],[62,74,137],[49,104,142],[38,130,142],[31,158,137],[53,183,121],[109,205,89],[180,222,44],[253,231,37]];
  const diverging = [[33,60,129],[58,110,177],[122,166,210],[196,217,233],[247,247,247],[248,214,180],[238,162,100],[205,104,36],[128,56,8]];
  const patchColours = [[150,160,170],[0,114,178],[213,94,0],[0,158,115],[204,121,167],[230,159,0],[86,180,233],[240,228,66],[120,94,240]];
  // three.js takes colours of vertices as linear light; the maps are sRGB, as the legend shows them.
  const linear = c => c <= 0.04045 ? c / 12.92 : Math.pow((c + 0.055) / 1.055, 2.4);
  const pick = (map, t) => {
    t = Math.min(1, Math.max(0, t)) * (map.length - 1);
    const i = Math.min(map.length - 2, Math.floor(t)), f = t - i;
    return map[i].map((c, k) => linear((c + f * (map[i + 1][k] - c)) / 255));
  };

  const renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
  renderer.localClippingEnabled = true;
  renderer.setPixelRatio(Math.min(2, window.devicePixelRatio || 1));
  host.appendChild(renderer.domElement);
  const scene = new THREE.Scene(), camera = new THREE.PerspectiveCamera(30, 1, 0.01, 1e6);
  scene.add(new THREE.HemisphereLight(0xffffff, 0xa0a8b0, 2.0));
  const lamp = new THREE.DirectionalLight(0xffffff, 1.9);
  camera.add(lamp); scene.add(camera);

  const n = triangles.length / 3, position = new Float32Array(9 * n), colour = new Float32Array(9 * n);
  for (let i = 0; i < 3 * n; i++) position.set(points.subarray(3 * triangles[i], 3 * triangles[i] + 3), 3 * i);
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute('position', new THREE.BufferAttribute(position, 3));
  geometry.setAttribute('color', new THREE.BufferAttribute(colour, 3));
  geometry.computeVertexNormals();
  const plane = new THREE.Plane(new THREE.Vector3(-1, 0, 0), 1e9);
  const material = new THREE.MeshLambertMaterial({ vertexColors: true, side: THREE.DoubleSide, clippingPlanes: [plane] });
  const surface = new THREE.Mesh(geometry, material);
  scene.add(surface);
  const edges = new Float32Array(18 * n);
  for (let t = 0; t < n; t++) for (let k = 0; k < 3; k++) {
    edges.set(position.subarray(9 * t + 3 * k, 9 * t + 3 * k + 3), 18 * t + 6 * k);
    const m = (k + 1) % 3; edges.set(position.subarray(9 * t + 3 * m, 9 * t + 3 * m + 3), 18 * t + 6 * k + 3);
  }
  const wireGeometry = new THREE.BufferGeometry();
  wireGeometry.setAttribute('position', new THREE.BufferAttribute(edges, 3));
  const wire = new THREE.LineSegments(wireGeometry, new THREE.LineBasicMaterial({ color: 0x20262c, transparent: true, opacity: 0.25, clippingPlanes: [plane] }));
  scene.add(wire);
  if (lines) {
    const g = new THREE.BufferGeometry(); g.setAttribute('position', new THREE.BufferAttribute(lines, 3));
    const c = new THREE.LineSegments(g, new THREE.LineBasicMaterial({ color: 0xd55e00, depthTest: false })); c.visible = false; c.name = 'centerlines';
    scene.add(c);
    document.getElementById('show-lines').onchange = e => { c.visible = e.target.checked; draw(); };
  }

  const box = new THREE.Box3().setFromBufferAttribute(geometry.getAttribute('position'));
  const center = box.getCenter(new THREE.Vector3()), size = box.getSize(new THREE.Vector3()).length();
  const controls = new THREE.TrackballControls(camera, renderer.domElement);
  controls.staticMoving = true; controls.rotateSpeed = 3;
  const home = () => {
    controls.target.copy(center); camera.up.set(0, 0, 1);
    camera.position.copy(center).add(new THREE.Vector3(0.3, -1.55, 0.3).multiplyScalar(size));
    camera.near = size / 1000; camera.far = size * 20; camera.updateProjectionMatrix();
  };
  home();

  const legend = document.getElementById('legend');
  const showLegend = (title, map, lo, hi) => {
    const stops = map.map((c, i) => `rgb(${c}) ${100 * i / (map.length - 1)}%`).join(',');
    legend.innerHTML = `${title}<i style="background:linear-gradient(90deg,${stops})"></i><div><span>${lo}</span><span>${hi}</span></div>`;
  };
  const quantile = (a, q) => { const s = Float32Array.from(a).sort(); return s[Math.min(s.length - 1, Math.floor(q * s.length))] || 0; };
  const fields = {
    patch: () => {
      legend.innerHTML = meta.patches.map(p => `<div style="justify-content:start;gap:.4rem"><i style="width:1rem;background:rgb(${patchColours[(p.id - 1) % 9]})"></i>${p.name}</div>`).join('');
      return t => { const c = patchColours[(patch[t] - 1) % 9].map(x => linear(x / 255)); return [c, c, c]; };
    },
    skewness: () => { showLegend('equi-angle skewness', viridis, 0, meta.limit); return t => { const c = pick(viridis, skew[t] / meta.limit); return [c, c, c]; }; },
    deviation: () => { showLegend('deviation from the mask (voxel diagonals)', diverging, -0.5, 0.5); return t => [0, 1, 2].map(k => pick(diverging, deviation[triangles[3 * t + k]] + 0.5)); },
    curvature: () => {
      const m = Math.max(quantile(curvature.map(Math.abs), 0.95), 1e-12);
      showLegend('Gaussian curvature (1/mm²)', diverging, (-m).toPrecision(2), m.toPrecision(2));
      return t => [0, 1, 2].map(k => pick(diverging, 0.5 + 0.5 * curvature[triangles[3 * t + k]] / m));
    },
  };
  const paint = name => {
    const f = fields[name]();
    for (let t = 0; t < n; t++) f(t).forEach((c, k) => colour.set(c, 9 * t + 3 * k));
    geometry.getAttribute('color').needsUpdate = true;
    draw();
  };

  // The cut: sections of the tetrahedra with a plane across x, y or z, coloured by equi-volume skewness.
  let section = null;
  const cut = () => {
    if (section) { scene.remove(section); section.geometry.dispose(); section = null; }
    const axis = document.getElementById('cut-axis').value;
    if (axis === 'none') { plane.set(new THREE.Vector3(-1, 0, 0), 1e9); draw(); return; }
    const a = { x: 0, y: 1, z: 2 }[axis], lo = box.min.getComponent(a), hi = box.max.getComponent(a);
    const at = lo + (hi - lo) * document.getElementById('cut-at').value / 1000;
    const normal = new THREE.Vector3().setComponent(a, -1);
    plane.set(normal, at);
    if (tets) {
      const xyz = [], rgb = [], rim = [];
      for (let t = 0; t < tets.length / 4; t++) {
        const v = [0, 1, 2, 3].map(k => tets[4 * t + k]), d = v.map(i => tetPoints[3 * i + a] - at);
        const below = [0, 1, 2, 3].filter(k => d[k] < 0), above = [0, 1, 2, 3].filter(k => d[k] >= 0);
        if (!below.length || !above.length) continue;
        const cross = (p, q) => { const f = d[p] / (d[p] - d[q]); return [0, 1, 2].map(c => tetPoints[3 * v[p] + c] + f * (tetPoints[3 * v[q] + c] - tetPoints[3 * v[p] + c])); };
        const poly = below.length === 2 ? [cross(below[0], above[0]), cross(below[0], above[1]), cross(below[1], above[1]), cross(below[1], above[0])]
          : below.length === 1 ? above.map(q => cross(below[0], q)) : below.map(p => cross(p, above[0]));
        const c = pick(viridis, sv[t]);
        for (let k = 1; k + 1 < poly.length; k++) { xyz.push(...poly[0], ...poly[k], ...poly[k + 1]); rgb.push(...c, ...c, ...c); }
        for (let k = 0; k < poly.length; k++) rim.push(...poly[k], ...poly[(k + 1) % poly.length]);
      }
      const g = new THREE.BufferGeometry();
      g.setAttribute('position', new THREE.BufferAttribute(new Float32Array(xyz), 3)); g.setAttribute('color', new THREE.BufferAttribute(new Float32Array(rgb), 3));
      section = new THREE.Group(); section.geometry = g;
      section.add(new THREE.Mesh(g, new THREE.MeshBasicMaterial({ vertexColors: true, side: THREE.DoubleSide, polygonOffset: true, polygonOffsetFactor: 1 })));
      const r = new THREE.BufferGeometry(); r.setAttribute('position', new THREE.BufferAttribute(new Float32Array(rim), 3));
      section.add(new THREE.LineSegments(r, new THREE.LineBasicMaterial({ color: 0x20262c, transparent: true, opacity: 0.5 })));
      scene.add(section);
      showLegend('equi-volume skewness on the cut', viridis, 0, 1);
    }
    draw();
  };
  document.getElementById('cut-axis').onchange = cut;
  document.getElementById('cut-at').oninput = cut;

  const marker = new THREE.Mesh(new THREE.SphereGeometry(1, 16, 12), new THREE.MeshBasicMaterial({ color: 0xd55e00, wireframe: true, depthTest: false }));
  marker.visible = false; scene.add(marker);
  document.querySelectorAll('[data-at]').forEach(b => b.addEventListener('click', () => {
    const p = new THREE.Vector3(...b.dataset.at.split(',').map(Number)), away = camera.position.clone().sub(controls.target).setLength(size * 0.12);
    controls.target.copy(p); camera.position.copy(p).add(away); marker.position.copy(p); marker.scale.setScalar(size * 0.004); marker.visible = true;
    // A cell lies inside: the cut goes through it.
    if (b.dataset.cut) {
      const a = { x: 0, y: 1, z: 2 }[b.dataset.cut], lo = box.min.getComponent(a), hi = box.max.getComponent(a);
      document.getElementById('cut-axis').value = b.dataset.cut;
      document.getElementById('cut-at').value = Math.round(1000 * (p.getComponent(a) - lo) / (hi - lo));
      cut();
      camera.position.copy(p).add(new THREE.Vector3().setComponent(a, size * 0.12)); camera.up.set(0, 0, a === 2 ? 0 : 1); if (a === 2) camera.up.set(0, 1, 0);
    }
    document.getElementById('viewer').scrollIntoView({ behavior: 'smooth' }); draw();
  }));

  let queued = false;
  const draw = () => { if (!queued) { queued = true; requestAnimationFrame(() => { queued = false; renderer.render(scene, camera); }); } };
  const resize = () => { const w = host.clientWidth, h = host.clientHeight; renderer.setSize(w, h); camera.aspect = w / h; camera.updateProjectionMatrix(); controls.handleResize(); draw(); };
  const dark = () => { renderer.setClearColor(getComputedStyle(host).backgroundColor === 'rgb(29, 35, 40)' ? 0x1d2328 : 0xf6f8f9); draw(); };
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', dark);
  controls.addEventListener('change', draw);
  const loop = () => { controls.update(); requestAnimationFrame(loop); };
  addEventListener('resize', resize);
  const field = document.getElementById('field');
  if (!deviation || !deviation.length) field.querySelector('[value=deviation]').remove();
  if (!curvature || !curvature.length) field.querySelector('[value=curvature]').remove();
  field.onchange = () => paint(field.value);
  document.getElementById('show-edges').onchange = e => { wire.visible = e.target.checked; draw(); };
  document.getElementById('home').onclick = () => { home(); marker.visible = false; draw(); };
  dark(); resize(); paint('patch'); loop();
  host.dataset.ready = 'yes';
})().catch(e => { document.getElementById('view').textContent = 'The 3D view could not start: ' + e.message + '. The pictures and tables below hold the same figures.'; });
