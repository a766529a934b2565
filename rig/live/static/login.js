// A link carries its token behind the #: the browser keeps it to itself until it is posted from here.
const form = document.querySelector("form");
const person = document.getElementById("name");
const token = decodeURIComponent(location.hash.slice(1));
if (form.dataset.mark === "wrong") {
  document.getElementById("answer").textContent = "This token opens nothing, or was used before.";
}
if (token) {
  history.replaceState(null, "", location.pathname);
  document.getElementById("token").value = token;
}
if (token && person.hidden) form.submit(); // on this machine the account is known: there is nothing to fill in
else (person.hidden ? document.getElementById("token") : person).focus();
