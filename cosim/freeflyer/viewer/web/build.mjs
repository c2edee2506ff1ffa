// Writes ../page/viewer.js, viewer.css and LICENSES.txt. The result depends on the sources and the lock file only.

import { build } from "esbuild";
import { readFile, readdir, writeFile } from "node:fs/promises";

const page = new URL("../page/", import.meta.url);
const LIMIT = 900_000; // bytes of viewer.js

await build({
  absWorkingDir: new URL(".", import.meta.url).pathname,
  entryPoints: { viewer: "src/main.js", "viewer-style": "src/all.css" },
  outdir: page.pathname,
  bundle: true,
  minify: true,
  format: "iife",
  target: ["chrome111", "firefox114", "safari16.4"],
  charset: "ascii",
  legalComments: "none",
  write: false,
}).then(async ({ outputFiles }) => {
  for (const file of outputFiles) {
    const script = file.path.endsWith(".js");
    const text = file.text;
    // The texts are put inside <script> and <style>.
    if (/<\/(script|style)|<!--/i.test(text)) throw new Error(`${file.path} contains the end of an element`);
    if (/\beval\(|new Function\(|\bimport\(/.test(text)) throw new Error(`${file.path} makes code from text`);
    if (script && text.length > LIMIT) throw new Error(`viewer.js has ${text.length} bytes, at most ${LIMIT} are expected`);
    await writeFile(new URL(script ? "viewer.js" : "viewer.css", page), text);
    console.log(script ? "viewer.js" : "viewer.css", text.length, "bytes");
  }
});

const parts = ["Libraries in viewer.js and viewer.css, and their licenses.\n"];
const { dependencies } = JSON.parse(await readFile(new URL("package.json", import.meta.url)));
for (const name of Object.keys(dependencies).sort()) {
  const folder = new URL(`node_modules/${name}/`, import.meta.url);
  const { version, license, homepage } = JSON.parse(await readFile(new URL("package.json", folder)));
  const file = (await readdir(folder)).find((entry) => /^licen[cs]e/i.test(entry));
  const text = (await readFile(new URL(file, folder), "utf8")).replaceAll("\r\n", "\n").trim();
  parts.push(`${"-".repeat(100)}\n${name} ${version} (${license}), ${homepage}\n\n${text}\n`);
}
await writeFile(new URL("LICENSES.txt", page), parts.join("\n"));
