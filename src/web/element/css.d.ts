// The bundle of the element has style sheets as texts.
declare module "*.css" {
  const text: string;
  export default text;
}
