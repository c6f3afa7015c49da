// Puts the page together: what the bus says goes to the views, what a person does to the server.
import { Link } from "./link.js";
import { showCar, showHealth, addLines } from "./views.js";
import { Map } from "./map.js";
import { Plots } from "./plots.js";
import { Controls } from "./controls.js";

const body = document.body;
const values = {};
const map = new Map(document.getElementById("map"));
const link = new Link({ onHello, onNews, onControl, onRefused, onState });
const plots = new Plots(link);
const controls = new Controls(link);

function onHello(hello) {
  document.getElementById("vehicle").textContent = hello.vehicle;
  document.getElementById("bus").textContent = hello.bus;
  document.title = `${hello.vehicle} · CAN-by-Wire`;
  values.hello = hello;
  controls.offer(hello);
  plots.offer(hello.signals);
}

function onNews(message) {
  const { path = [], log = [], ...news } = message.news;
  if (message.anew) {
    map.clear();
    document.getElementById("log").replaceChildren();
  }
  Object.assign(values, news);
  showCar(values);
  if (message.anew || "nodes" in news || "codes" in news || "load" in news) showHealth(values);
  map.take(path, values);
  addLines(log);
  plots.take(message.t, message.plots);
  controls.show(values);
}

function onControl(isGranted) {
  controls.grant(isGranted);
}

function onRefused(text) {
  controls.refuse(text);
}

// What is old must not look like what is true: no news from the server, or none from the bus.
function onState(link) {
  const sign = document.getElementById("connection");
  const alarm = document.getElementById("alarm");
  let text = "";
  if (!link.isFresh) text = link.wasOpen
    ? `No news for ${link.silentText}: what is shown is old. Reconnecting…`
    : "No connection to the dashboard. Connecting…";
  else if (!values.heard) text = "Nothing heard on the bus yet.";
  else if (values.silent_s) text = `The bus is silent for ${values.silent_s.toFixed(1)} s.`;
  sign.dataset.is = link.isFresh ? (text ? "silent" : "live") : "lost";
  sign.textContent = link.isFresh ? (text ? "bus silent" : "live") : "stale";
  alarm.hidden = !text;
  if (alarm.textContent !== text) alarm.textContent = text;
  body.classList.toggle("stale", text !== "");
  controls.setFresh(link.isFresh);
}

const root = document.documentElement;
const bright = matchMedia("(prefers-color-scheme: light)");
function setTheme(name) {
  root.dataset.theme = name;
  map.draw();
  plots.redraw();
}
setTheme(localStorage.getItem("theme") ?? (bright.matches ? "bright" : "dark"));
document.getElementById("theme").addEventListener("click", () => {
  const name = root.dataset.theme === "dark" ? "bright" : "dark";
  localStorage.setItem("theme", name);
  setTheme(name);
});
link.open();
