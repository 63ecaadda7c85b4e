#!/bin/sh
# Makes src/ohmskin/view/static/vendor/three.js anew: the parts of three.js (MIT licence) that the page of a body uses.
# Needs npm; run it with another version of three to update.
set -e
version=${1:-0.187.0}
root=$(cd "$(dirname "$0")/.." && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
npm install --silent "three@$version" esbuild@0.25
cat > entry.js <<'EOF'
export {
  AmbientLight, Box3, BoxGeometry, BufferAttribute, BufferGeometry, CapsuleGeometry, Color, ColorManagement,
  ConeGeometry, CylinderGeometry, DirectionalLight, DoubleSide, GridHelper, Group, LinearSRGBColorSpace,
  LineBasicMaterial, LineSegments, Matrix4, Mesh, MeshLambertMaterial, PerspectiveCamera, Raycaster, Scene, Sphere,
  SphereGeometry, Vector2, Vector3, WebGLRenderer,
} from "three";
export { OrbitControls } from "three/addons/controls/OrbitControls.js";
EOF
npx esbuild entry.js --bundle --minify --format=esm --legal-comments=inline \
  --banner:js="/*! three.js $version, https://threejs.org, MIT licence; made by tools/three.sh */" \
  --outfile="$root/src/ohmskin/view/static/vendor/three.js"
