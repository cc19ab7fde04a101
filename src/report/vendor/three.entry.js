export { WebGLRenderer, Scene, PerspectiveCamera, BufferGeometry, BufferAttribute, Mesh, MeshLambertMaterial, MeshBasicMaterial, LineSegments, LineBasicMaterial, HemisphereLight, DirectionalLight, Vector3, Box3, Plane, DoubleSide, SphereGeometry, WireframeGeometry, Color, Group } from 'three';
export { TrackballControls } from 'three/examples/jsm/controls/TrackballControls.js';
