// Draws the contract of this very server. Nothing else is asked for: no validator, no fonts, no examples from elsewhere.
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
  // A key is kept by this tab's memory alone, and goes with "Try it out" to this server alone.
  persistAuthorization: false,
  validatorUrl: null,
});
