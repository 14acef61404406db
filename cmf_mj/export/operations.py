"""Floating-point operations of generated C: how many a call takes at most.

It reads the C that `law_source` writes, functions of declarations, `for` with constant bounds, `if`
and expressions, and counts what stands there: a loop is its body as often as it can run, of two
branches each kind of operation counts as often as in the branch with more of it, both sides of a
conditional expression count. Indices and loop counters count nothing.
"""

import re
from collections import Counter
from collections.abc import Iterator

_KINDS = {
    "+": "additions",
    "-": "additions",
    "*": "multiplications",
    "/": "divisions",
    "sqrt": "roots",
    "sin": "sines and cosines",
    "cos": "sines and cosines",
    "fabs": "magnitudes",
}
"""Kinds by the first letter of an operator, or by function."""

_NOT_CODE = re.compile(
    r"/\*.*?\*/|^#.*?$|\[[^\[\]]*\]|\bcmf_\w+ \*(?:const)?", re.DOTALL | re.MULTILINE
)
_TOKEN = re.compile(r"\d[\w.]*(?:(?<=e)[+-]\d+\w?)?|\w+|->|&&|\|\||\+\+|[-+*/<>=!]=|\S")
_FUNCTION = re.compile(r"^(?:static )?\w+ (\w+)\([^)]*\) (?=\{)", re.MULTILINE)
_DEFINED = re.compile(r"^#define (\w+) (\w+)", re.MULTILINE)


def operations(source: str, function: str) -> Counter[str]:
    """Operations of a call of `function` in C source, at most, by kind."""
    numbers = dict(_DEFINED.findall(source))
    return _Functions(_NOT_CODE.sub("", _NOT_CODE.sub("", source)), numbers).call(function)


class _Functions:
    """Functions of a source, and what a call of each takes."""

    def __init__(self, code: str, numbers: dict[str, str]) -> None:
        self.bodies = {match[1]: code[match.end() :] for match in _FUNCTION.finditer(code)}
        self.numbers, self.known = numbers, dict[str, Counter[str]]()

    def call(self, name: str) -> Counter[str]:
        if name not in self.known:
            self.known[name] = _Reader(self, self.bodies[name]).statement()
        return self.known[name]

    def number(self, word: str) -> int:
        """The whole number that a word stands for."""
        while not word.isdigit():
            word = self.numbers[word]
        return int(word)


class _Reader:
    """Statements one after the other."""

    def __init__(self, functions: _Functions, code: str) -> None:
        self.functions = functions
        self.tokens: Iterator[str] = iter(_TOKEN.findall(code))
        self.next = next(self.tokens)

    def take(self) -> str:
        taken, self.next = self.next, next(self.tokens, "")
        return taken

    def statement(self) -> Counter[str]:
        """Operations of the next statement."""
        if self.next == "{":
            self.take()
            found: Counter[str] = Counter()
            while self.next != "}":
                found += self.statement()
            self.take()
            return found
        if self.next == "for":
            head = self.bracket()
            times = self.functions.number(" ".join(head).split(" ; ")[1].split()[-1])
            times += "<=" in head
            return Counter({kind: times * n for kind, n in self.statement().items()})
        if self.next == "if":
            found = self.count(self.bracket())
            branch = self.statement()
            if self.next == "else":
                self.take()
                branch |= self.statement()
            return found + branch
        words = []
        while self.next != ";":
            words.append(self.take())
        self.take()
        return self.count(words)

    def bracket(self) -> list[str]:
        """What stands in round brackets behind the next word."""
        self.take()
        words, depth = [self.take()], 1
        while depth:
            depth += {"(": 1, ")": -1}.get(self.next, 0)
            words.append(self.take())
        return words

    def count(self, words: list[str]) -> Counter[str]:
        """Operations of an expression or declaration."""
        found: Counter[str] = Counter()
        for before, word, after in zip(["", *words], words, [*words[1:], ""], strict=False):
            called = word.removesuffix("f") if after == "(" else ""
            if word in self.functions.bodies:
                found += self.functions.call(word)
            elif called in _KINDS:
                found[_KINDS[called]] += 1
            elif word[0] in "+-*/" and word != "->":
                unary = before in ("", "(", "=", ",", "return", "?", ":") or before[-1] == "="
                found[_KINDS[word[0]]] += not unary
            elif word in ("<", ">", "<=", ">=", "==", "!="):
                found["comparisons"] += 1
        return found


def stated(counts: Counter[str]) -> str:
    """Counts in words, the commonest kind first."""
    parts = [f"{number} {kind}" for kind, number in counts.most_common()]
    return " and ".join(filter(None, (", ".join(parts[:-1]), parts[-1])))
