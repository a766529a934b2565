// A link carries its token behind the #: the browser keeps it to itself until it is posted from here.
const form = document.querySelector("form");
const token = decodeURIComponent(location.hash.slice(1));
if (token) {
  history.replaceState(null, "", location.pathname);
  document.getElementById("token").value = token;
}
if (form.dataset.mark === "wrong") {
  document.getElementById("said").textContent = "This token opens nothing, or was used before.";
}
document.getElementById("name").focus();
