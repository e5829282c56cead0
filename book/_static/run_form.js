/* The form "Run it with your parameters": prints the commands for what a reader types. No request, no storage. */
(function () {
  "use strict";

  var RULES = {
    int: [/^[-+]?[0-9]{1,1000}$/, "a whole number, such as 3"],
    float: [/^[-+]?(([0-9]+\.?[0-9]*|\.[0-9]+)(e[-+]?[0-9]+)?|inf|nan)$/i, "a number, such as 1e-3"],
  };
  var MUST_BE = { list: "a list in YAML, such as [1, 2]", dict: "a dictionary in YAML, such as {a: 1}" };
  var RESERVED = /^(yes|no|on|off|true|false|null)$/i;

  // ---- YAML on one line, as repro run reads it; written so that version 1.1 of YAML reads the same -----------------

  function text(value) {
    return JSON.stringify(value).replace(/[\x7f-\x9f\u2028\u2029\ufeff]/g, function (c) {
      return "\\u" + ("000" + c.charCodeAt(0).toString(16)).slice(-4);
    });
  }

  function number(plain) { // a number in a form that is no text to anybody
    var sign = /^-/.test(plain) ? "-" : "";
    var body = plain.replace(/^[-+]/, "").toLowerCase();
    if (/^\.?(inf|nan)$/.test(body)) return (/nan$/.test(body) ? "." : sign + ".") + body.replace(".", "");
    if (/^[0-9]+$/.test(body)) return sign + (body.replace(/^0+(?=[0-9])/, ""));
    var parts = body.split("e");
    var mantissa = parts[0].indexOf(".") < 0 ? parts[0] + ".0" : parts[0].replace(/^\./, "0.").replace(/\.$/, ".0");
    return sign + mantissa + (parts.length > 1 ? "e" + parts[1].replace(/^(?=[0-9])/, "+") : "");
  }

  function scalar(plain) {
    if (/^(~|null|Null|NULL|)$/.test(plain)) return "null";
    if (/^(true|True|TRUE|false|False|FALSE)$/.test(plain)) return plain.toLowerCase();
    if (/^[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?$|^[-+]?\.(inf|Inf|INF)$|^\.(nan|NaN|NAN)$/.test(plain))
      return number(plain);
    if (/^[-?:,\[\]{}#&*!|>'"%@`]/.test(plain) && !/^-[^\s]/.test(plain)) throw Error(plain);
    if (/[\[\]{}]|\s#|:\s|:$/.test(plain)) throw Error(plain);
    return text(plain);
  }

  function flow(source, kind) { // returns the value as YAML again, and its parts; throws where it is none
    var at = 0, parts = [];
    function space() { while (/\s/.test(source.charAt(at))) at += 1; }
    function quoted() {
      var rest = source.slice(at);
      var found = /^"(?:[^"\\]|\\.)*"/.exec(rest);
      if (found) { at += found[0].length; return text(JSON.parse(found[0])); }
      found = /^'((?:[^']|'')*)'/.exec(rest);
      if (!found) throw Error(rest);
      at += found[0].length;
      return text(found[1].replace(/''/g, "'"));
    }
    function key() {
      space();
      if (/["']/.test(source.charAt(at))) return quoted();
      var found = /^[^,\[\]{}]*?(?=\s*:(?:\s|[,\[\]{}]|$))/.exec(source.slice(at));
      if (!found) throw Error(source);
      at += found[0].length;
      var written = scalar(found[0]);
      if (!/^"/.test(written)) throw Error(written); // the names in a dictionary are texts
      return written;
    }
    function item(depth) {
      space();
      var first = source.charAt(at);
      if (depth > 19) throw Error(source);
      if (first === "[" || first === "{") return collection(first, depth);
      if (first === '"' || first === "'") return quoted();
      var found = /^[^,\[\]{}]*/.exec(source.slice(at))[0];
      at += found.length;
      return scalar(found.trim());
    }
    function collection(open, depth) {
      var close = open === "[" ? "]" : "}", items = [], seen = {};
      at += 1;
      for (;;) {
        space();
        if (source.charAt(at) === close) break;
        if (source.charAt(at) === ",") throw Error(source);
        if (open === "{") {
          var name = key();
          space();
          if (source.charAt(at) !== ":" || seen["=" + name]) throw Error(source);
          seen["=" + name] = true;
          at += 1;
          items.push(name + ": " + item(depth + 1));
        } else items.push(item(depth + 1));
        if (depth === 0) parts = items;
        space();
        if (source.charAt(at) === ",") at += 1;
        else if (source.charAt(at) !== close) throw Error(source);
      }
      at += 1;
      return open + items.join(", ") + close;
    }
    space();
    if (source.charAt(at) !== (kind === "list" ? "[" : "{")) throw Error(source);
    var written = item(0);
    space();
    if (at < source.length) throw Error(source);
    return { line: written, parts: parts };
  }

  // ---- what is allowed, from the attributes that Python wrote; repro run checks the same --------------------------

  function allowsOne(rule, part) { // a part as YAML
    if (rule.choices) return JSON.parse(rule.choices).some(function (choice) {
      if (typeof choice !== "number") return part === text(choice);
      return /^-?[0-9]/.test(part) && Number(part) === choice && /^-?[0-9]+$/.test(part) === Number.isInteger(choice);
    });
    if (!/^-?[0-9.]/.test(part) || !isFinite(Number(part))) return false; // a text, true, null or .inf
    var whole = /^-?[0-9]+$/.test(part), value = Number(part);
    if (whole ? !Number.isSafeInteger(value) : rule.whole) return false;
    if (rule.low !== undefined && (rule.above ? value <= +rule.low : value < +rule.low)) return false;
    return rule.high === undefined || (rule.below ? value < +rule.high : value <= +rule.high);
  }

  function allows(rule, parts, isList) {
    if (!parts.every(function (part) { return allowsOne(rule, part); })) return false;
    if (!isList) return true;
    var keys = parts.map(function (part) { return /^"/.test(part) ? part : String(Number(part)); });
    if (rule.once && keys.some(function (key, k) { return keys.indexOf(key) < k; })) return false;
    if (rule.count && parts.length && parts.length !== +rule.count) return false;
    if (rule.among && !parts.some(function (part) { return Number(part) === +rule.among; })) return false;
    return !rule.filled || parts.length > 0;
  }

  // ---- values and commands ----------------------------------------------------------------------------------------

  function read(field, value) { // {typed, yaml}: as typed for repro run, and as YAML; throws a message
    var kind = field.dataset.type, rule = field.dataset;
    var found = convert(kind, value);
    if (rule.mustBe && !allows(rule, found.parts, kind === "list")) throw Error(rule.mustBe);
    return found;
  }

  function convert(kind, value) {
    if (kind === "bool") return { typed: String(value), yaml: String(value), parts: [] };
    if (kind === "str") {
      if (/^(-h|--help|--)$/.test(value)) throw Error("another text than " + value + ", which repro does not read as a value");
      return { typed: value, yaml: text(value), parts: [text(value)] };
    }
    value = value.trim();
    if (RULES[kind]) {
      if (!RULES[kind][0].test(value)) throw Error(RULES[kind][1]);
      var written = number(value);
      var yaml = kind === "float" && /^-?[0-9]+$/.test(written) ? written + ".0" : written;
      return { typed: value, yaml: yaml, parts: [yaml] };
    }
    try {
      var found = flow(value.replace(/\s*[\r\n]+\s*/g, " "), kind);
      return { typed: found.line, yaml: found.line, parts: found.parts };
    } catch (error) {
      throw Error(MUST_BE[kind]);
    }
  }

  function state(field, own) { // what a field holds now, or what the notebook has
    if (field.matches("div")) { // boxes to tick: a list
      var boxes = Array.prototype.slice.call(field.querySelectorAll("input"));
      var chosen = boxes.filter(function (box) { return own ? box.defaultChecked : box.checked; });
      return "[" + chosen.map(function (box) { return box.value; }).join(", ") + "]";
    }
    if (field.matches("select")) {
      var options = Array.prototype.slice.call(field.options);
      return own ? options.filter(function (option) { return option.defaultSelected; })[0].value : field.value;
    }
    if (field.type === "checkbox") return own ? field.defaultChecked : field.checked;
    return own ? field.defaultValue : field.value;
  }

  function fit(field) { // a box of text is as high as its lines
    if (!field.matches("textarea")) return;
    field.style.height = "auto";
    field.style.height = field.scrollHeight + field.offsetHeight - field.clientHeight + "px";
  }

  function quote(word) { // for any POSIX shell
    return /^[A-Za-z0-9_@%+=:,.\/-]+$/.test(word) ? word : "'" + word.replace(/'/g, "'\\''") + "'";
  }

  function forPapermill(name, kind, value) {
    var key = RESERVED.test(name) ? text(name) : name;
    if (kind === "str") return " -r " + name + " " + quote(value.typed); // -p would make a number of "1"
    if (kind === "int") return " -p " + name + " " + quote(value.yaml);
    if (kind === "float") return " -p " + name + " " + quote(value.yaml.replace(/\.(?=inf|nan)/, ""));
    return " -y " + quote(key + ": " + value.yaml);
  }

  function start(box) {
    var form = box.querySelector("form");
    var fields = Array.prototype.slice.call(form.querySelectorAll("[data-name]"));
    var outputs = box.querySelector(".run-form-commands");
    var refused = box.querySelector(".run-form-refused");
    var download = box.querySelector(".run-form-yaml");
    var shown = {};
    ["repro", "papermill", "yaml"].forEach(function (key) {
      var block = box.querySelector('[data-command="' + key + '"]');
      shown[key] = { block: block, first: block.textContent };
    });

    function show(key, value) {
      shown[key].block.textContent = value;
    }

    function update() {
      var repro = shown.repro.first, papermill = shown.papermill.first, yaml = "", changed = 0, wrong = 0;
      fields.forEach(function (field) {
        var name = field.dataset.name, kind = field.dataset.type;
        var message = "";
        try {
          var value = read(field, state(field, false)), own = convert(kind, state(field, true));
          yaml += (RESERVED.test(name) ? text(name) : name) + ": " + value.yaml + "\n";
          if (value.yaml !== own.yaml) {
            changed += 1;
            repro += " -p " + name + " " + quote(value.typed);
            papermill += forPapermill(name, kind, value);
          }
        } catch (error) {
          message = "Must be " + error.message;
          wrong += 1;
        }
        var place = document.getElementById(field.id + "-error");
        if (place.textContent !== message) place.textContent = message;
        if (message) field.setAttribute("aria-invalid", "true");
        else field.removeAttribute("aria-invalid");
        fit(field);
      });
      outputs.hidden = wrong > 0;
      refused.hidden = wrong === 0;
      var counted = changed === 0 ? "No value changed" : changed === 1 ? "1 value changed" : changed + " values changed";
      if (wrong) counted = wrong === 1 ? "1 value is not allowed" : wrong + " values are not allowed";
      form.querySelector('[role="status"]').textContent = counted;
      if (wrong) return;
      show("repro", repro);
      show("papermill", papermill);
      show("yaml", yaml);
      download.href = "data:text/yaml;charset=utf-8," + encodeURIComponent(yaml);
    }

    form.addEventListener("input", update);
    window.addEventListener("resize", function () { fields.forEach(fit); });
    form.addEventListener("reset", function () { setTimeout(update, 0); });
    form.addEventListener("submit", function (event) { event.preventDefault(); });
    form.hidden = false;
    update(); // a browser may have kept what was typed before a reload
  }

  function startAll() { Array.prototype.forEach.call(document.querySelectorAll(".run-form"), start); }
  if (document.readyState === "loading") document.addEventListener("DOMContentLoaded", startAll);
  else startAll();
})();
