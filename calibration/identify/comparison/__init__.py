"""Models of an arm beside each other, by runs left out."""
