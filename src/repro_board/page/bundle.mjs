// Writes vendor/shape_viewer.js anew: the sources beside this file with three.js, as one classic script, since browsers load
// no modules from a disk. `node bundle.mjs FOLDER` installs the packages of package-lock.json in FOLDER, never here.

import { execFileSync } from "node:child_process";
import { createHash } from "node:crypto";
import { copyFileSync, mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { join, resolve } from "node:path";
import { fileURLToPath } from "node:url";

const SOURCES = ["viewer.js", "colours.js", "style.css"];
const PACKAGES = ["package.json", "package-lock.json", ".npmrc"];

const here = fileURLToPath(new URL(".", import.meta.url));
const vendor = join(here, "vendor");
const folder = resolve(process.argv[2] ?? ".cache/viewer");
mkdirSync(folder, { recursive: true });
for (const name of [...SOURCES, ...PACKAGES]) copyFileSync(join(here, name), join(folder, name));
execFileSync("npm", ["ci", "--no-audit", "--no-fund", "--ignore-scripts", "--silent"], { cwd: folder, stdio: "inherit" });

const esbuild = createRequire(join(folder, "package.json"))("esbuild");
await esbuild.build({
  absWorkingDir: folder, entryPoints: ["viewer.js"], outfile: join(vendor, "shape_viewer.js"),
  bundle: true, minify: true, format: "iife", globalName: "reproViewer", target: "es2022", charset: "utf8",
  loader: { ".css": "text" }, legalComments: "inline", logLevel: "warning",
});
copyFileSync(join(folder, "node_modules/three/LICENSE"), join(vendor, "LICENSE.three"));

// What it was made from: a test compares these with the files
const { packages } = JSON.parse(readFileSync(join(here, "package-lock.json"), "utf8"));
const version = (name) => packages[`node_modules/${name}`].version;
const files = ["vendor/shape_viewer.js", "vendor/LICENSE.three", "package-lock.json", ...SOURCES];
const hash = (name) => createHash("sha256").update(readFileSync(join(here, name))).digest("hex");
const manifest = {
  three: version("three"), esbuild: version("esbuild"), licence: "MIT",
  sha256: Object.fromEntries(files.map((name) => [name, hash(name)])),
};
writeFileSync(join(vendor, "manifest.json"), `${JSON.stringify(manifest, null, 2)}\n`);
