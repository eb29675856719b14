"use strict";
// Hands the token in the address over for a session, takes it out of the address, and lets the page begin.
window.session = (async () => {
  const token = new URLSearchParams(location.hash.slice(1)).get("token") ?? location.hash.slice(1);
  if (token) {
    history.replaceState(null, "", location.pathname);
    await fetch("/session", { method: "POST", headers: { Authorization: `Bearer ${token}` } });
  }
  if (!(await fetch("/session")).ok) {
    document.getElementById("refused").hidden = false;
    return false;
  }
  if (document.body.dataset.live === "no") location.replace("/runs");
  return true;
})();
