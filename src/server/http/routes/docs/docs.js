// Shows the API document of this server. Nothing is loaded from other hosts: no validator, no fonts.
const dark = matchMedia("(prefers-color-scheme: dark)");
const follow = () => document.documentElement.classList.toggle("dark-mode", dark.matches);
follow();
dark.addEventListener("change", follow);

window.ui = SwaggerUIBundle({
  url: "openapi.json",
  dom_id: "#contract",
  deepLinking: true,
  docExpansion: "list",
  defaultModelsExpandDepth: 0,
  displayRequestDuration: true,
  // The key stays in the memory of this tab and is sent only to this server, by "Try it out".
  persistAuthorization: false,
  validatorUrl: null,
});
