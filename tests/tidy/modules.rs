//! What the sources of one crate say of each other: which module names which, where inherent
//! `impl`s stand, and which functions take tuples. Read with `syn`; test code does not count.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use proc_macro2::{TokenStream, TokenTree};
use quote::ToTokens as _;
use syn::visit::{self, Visit};
use syn::{FnArg, Item, Type, UseTree, Visibility};

/// A module's path below the crate's root; the root's is empty.
pub type ModulePath = Vec<String>;

/// The sources of one crate.
#[derive(Default)]
pub struct Sources {
    modules: BTreeMap<ModulePath, Module>,
}

/// One source file.
#[derive(Default)]
struct Module {
    file: PathBuf,
    /// Paths that are named, with the leading `crate`, `self`, `super` or child's name.
    named: Vec<Vec<String>>,
    /// Paths that are re-exported.
    reexported: Vec<Vec<String>>,
    /// Paths that are imported, as they are written.
    imported: Vec<Vec<String>>,
    /// Types that are defined here.
    types: BTreeSet<String>,
    /// Types that have an inherent `impl` here.
    inherent: BTreeSet<String>,
    /// Functions with a parameter that is a tuple, or a reference to one.
    with_tuples: Vec<String>,
}

impl Sources {
    /// Reads every `.rs` file below `folder`, a crate's `src`.
    pub fn read(folder: &Path) -> Self {
        let mut files = Vec::new();
        super::sources(folder, &mut files);
        let mut sources = Self::default();
        for file in files {
            let text = std::fs::read_to_string(&file).unwrap();
            sources.add(file.strip_prefix(folder).unwrap(), &text);
        }
        sources
    }

    /// Adds one file by its path below `src`.
    pub fn add(&mut self, file: &Path, text: &str) {
        let mut path: ModulePath =
            file.with_extension("").iter().map(|part| part.to_string_lossy().into_owned()).collect();
        if path.last().is_some_and(|last| matches!(last.as_str(), "mod" | "lib" | "main")) {
            path.pop();
        }
        if path.last().is_some_and(|last| last == "tests" || last.ends_with("_tests")) {
            return;
        }
        let parsed = syn::parse_file(text).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
        let mut module = Module { file: file.to_path_buf(), ..Module::default() };
        parsed.items.iter().for_each(|item| module.take(item));
        self.modules.insert(path, module);
    }

    /// How many modules there are.
    pub fn len(&self) -> usize {
        self.modules.len()
    }

    /// The groups of modules that reach each other, each with the paths that bind it.
    pub fn cycles(&self) -> Vec<String> {
        let arrows: BTreeMap<&ModulePath, BTreeMap<&ModulePath, String>> =
            self.modules.iter().map(|(from, module)| (from, self.arrows(from, module))).collect();
        let reach: BTreeMap<&ModulePath, BTreeSet<&ModulePath>> =
            arrows.keys().map(|from| (*from, reachable(&arrows, from))).collect();
        let mut seen = BTreeSet::new();
        let mut cycles = Vec::new();
        for (from, to) in &reach {
            if !to.contains(from) || seen.contains(from) {
                continue;
            }
            let group: BTreeSet<_> = to.iter().copied().filter(|other| reach[other].contains(from)).collect();
            let mut lines = Vec::new();
            for member in &group {
                for (target, by) in arrows[*member].iter().filter(|(target, _)| group.contains(*target)) {
                    lines.push(format!("    {} -> {} by `{by}`", shown(member), shown(target)));
                }
            }
            cycles.push(format!("{} modules reach each other:\n{}", group.len(), lines.join("\n")));
            seen.extend(group);
        }
        cycles
    }

    /// Types whose inherent `impl`s stand in more than `max` files, with the files.
    pub fn scattered_impls(&self, max: usize) -> Vec<String> {
        let mut files: BTreeMap<(ModulePath, &str), BTreeSet<&Path>> = BTreeMap::new();
        for (path, module) in &self.modules {
            for name in &module.inherent {
                let home = if module.types.contains(name) {
                    path.clone()
                } else {
                    let import = module.imported.iter().chain(&module.named).find(|p| p.last() == Some(name));
                    import.and_then(|p| self.target(path, p)).unwrap_or_default()
                };
                files.entry((home, name)).or_default().insert(&module.file);
            }
        }
        let scattered = files.into_iter().filter(|(_, files)| files.len() > max);
        scattered.map(|((_, name), files)| format!("{name} in {files:?}")).collect()
    }

    /// Functions that take a tuple, with their files.
    pub fn tuple_parameters(&self) -> Vec<String> {
        let of = |module: &Module| -> Vec<String> {
            module.with_tuples.iter().map(|name| format!("{}: {name}", module.file.display())).collect()
        };
        self.modules.values().flat_map(of).collect()
    }

    fn arrows(&self, from: &ModulePath, module: &Module) -> BTreeMap<&ModulePath, String> {
        let mut arrows = BTreeMap::new();
        for path in &module.named {
            let Some(to) = self.target(from, path).filter(|to| to != from) else { continue };
            let (to, _) = self.modules.get_key_value(&to).unwrap();
            arrows.entry(to).or_insert_with(|| path.join("::"));
        }
        arrows
    }

    /// The module that a path, as it is written in `from`, leads to; `None` for another crate's.
    fn target(&self, from: &ModulePath, path: &[String]) -> Option<ModulePath> {
        self.resolve(&self.absolute(from, path)?, 0)
    }

    fn absolute(&self, from: &ModulePath, path: &[String]) -> Option<Vec<String>> {
        let first = path.first()?.as_str();
        match first {
            "crate" => Some(path[1..].to_vec()),
            "self" => Some([from, &path[1..]].concat()),
            "super" => {
                let ups = path.iter().take_while(|part| *part == "super").count();
                let base = from.get(..from.len().checked_sub(ups)?)?;
                Some([base, &path[ups..]].concat())
            }
            child => {
                let below = [from.as_slice(), &[child.to_owned()]].concat();
                self.modules.contains_key(&below).then(|| [from.as_slice(), path].concat())
            }
        }
    }

    /// The module that defines what an absolute path names: re-exports are followed.
    fn resolve(&self, path: &[String], depth: usize) -> Option<ModulePath> {
        let length = (0..=path.len()).rev().find(|n| self.modules.contains_key(&path[..*n]))?;
        let (module, rest) = path.split_at(length);
        let Some(name) = rest.first() else { return Some(module.to_vec()) };
        if depth < 8 {
            for exported in &self.modules[module].reexported {
                let Some(at) = self.absolute(&module.to_vec(), exported) else { continue };
                if at.last() == Some(name) && at != path {
                    return self.resolve(&[&at, &rest[1..]].concat(), depth + 1);
                }
                if at.last().is_some_and(|last| last == "*") {
                    let through = [&at[..at.len() - 1], rest].concat();
                    let target = self.resolve(&through, depth + 1)?;
                    if target.len() >= at.len() || self.modules[&target].types.contains(name) {
                        return Some(target);
                    }
                }
            }
        }
        Some(module.to_vec())
    }
}

impl Module {
    fn take(&mut self, item: &Item) {
        if is_for_tests(item) {
            return;
        }
        match item {
            Item::Use(item) => {
                let mut paths = Vec::new();
                leaves(&item.tree, &mut Vec::new(), &mut paths);
                if matches!(item.vis, Visibility::Inherited) {
                    self.imported.extend(paths.iter().cloned());
                    self.named.extend(paths);
                } else {
                    self.reexported.extend(paths);
                }
                return;
            }
            Item::Mod(inner) => {
                if let Some((_, items)) = &inner.content {
                    items.iter().for_each(|item| self.take(item));
                }
                return;
            }
            Item::Struct(item) => self.define(&item.ident),
            Item::Enum(item) => self.define(&item.ident),
            Item::Trait(item) => self.define(&item.ident),
            Item::Type(item) => self.define(&item.ident),
            Item::Impl(item) if item.trait_.is_none() => {
                if let Type::Path(path) = &*item.self_ty {
                    self.inherent.extend(path.path.segments.last().map(|segment| segment.ident.to_string()));
                }
            }
            _ => {}
        }
        let mut tuples = Tuples::default();
        tuples.visit_item(item);
        self.with_tuples.extend(tuples.functions);
        paths_in(item.to_token_stream(), &mut self.named);
    }

    fn define(&mut self, name: &syn::Ident) {
        self.types.insert(name.to_string());
    }
}

/// Collects functions and methods with a parameter that is a tuple.
#[derive(Default)]
struct Tuples {
    functions: Vec<String>,
}

impl<'a> Visit<'a> for Tuples {
    fn visit_signature(&mut self, signature: &'a syn::Signature) {
        let takes = signature.inputs.iter().any(|input| match input {
            FnArg::Typed(input) => is_tuple(&input.ty),
            FnArg::Receiver(_) => false,
        });
        if takes {
            self.functions.push(signature.ident.to_string());
        }
        visit::visit_signature(self, signature);
    }
}

fn is_tuple(of: &Type) -> bool {
    match of {
        Type::Tuple(tuple) => !tuple.elems.is_empty(),
        Type::Reference(reference) => is_tuple(&reference.elem),
        Type::Paren(inner) => is_tuple(&inner.elem),
        _ => false,
    }
}

fn is_for_tests(item: &Item) -> bool {
    let attributes = match item {
        Item::Mod(item) => &item.attrs,
        Item::Use(item) => &item.attrs,
        Item::Fn(item) => &item.attrs,
        Item::Impl(item) => &item.attrs,
        Item::Struct(item) => &item.attrs,
        Item::Enum(item) => &item.attrs,
        Item::Const(item) => &item.attrs,
        Item::Static(item) => &item.attrs,
        _ => return false,
    };
    attributes.iter().any(|attribute| {
        let text = attribute.meta.to_token_stream().to_string();
        text.starts_with("cfg") && text.split(|c: char| !c.is_alphanumeric()).any(|word| word == "test")
    })
}

/// The paths that a `use` names, one a leaf.
fn leaves(tree: &UseTree, above: &mut Vec<String>, found: &mut Vec<Vec<String>>) {
    let with = |name: String| above.iter().cloned().chain([name]).collect();
    match tree {
        UseTree::Path(path) => {
            above.push(path.ident.to_string());
            leaves(&path.tree, above, found);
            above.pop();
        }
        UseTree::Name(name) if name.ident == "self" => found.push(above.clone()),
        UseTree::Name(name) => found.push(with(name.ident.to_string())),
        UseTree::Rename(name) => found.push(with(name.ident.to_string())),
        UseTree::Glob(_) => found.push(with("*".to_owned())),
        UseTree::Group(group) => group.items.iter().for_each(|tree| leaves(tree, above, found)),
    }
}

/// Every `a::b::c` among tokens, macros' included.
fn paths_in(tokens: TokenStream, found: &mut Vec<Vec<String>>) {
    let mut path: Vec<String> = Vec::new();
    let mut colons = 0;
    let mut close = |path: &mut Vec<String>| {
        if path.len() > 1 {
            found.push(std::mem::take(path));
        }
        path.clear();
    };
    let mut inner = Vec::new();
    for token in tokens {
        match token {
            TokenTree::Ident(name) => {
                if colons != 2 {
                    close(&mut path);
                }
                path.push(name.to_string());
                colons = 0;
            }
            TokenTree::Punct(punct) if punct.as_char() == ':' => colons += 1,
            other => {
                close(&mut path);
                colons = 0;
                if let TokenTree::Group(group) = other {
                    inner.push(group.stream());
                }
            }
        }
    }
    close(&mut path);
    inner.into_iter().for_each(|tokens| paths_in(tokens, found));
}

fn reachable<'a>(
    arrows: &BTreeMap<&'a ModulePath, BTreeMap<&'a ModulePath, String>>,
    from: &'a ModulePath,
) -> BTreeSet<&'a ModulePath> {
    let mut reached = BTreeSet::new();
    let mut left = vec![from];
    while let Some(next) = left.pop() {
        left.extend(arrows[next].keys().copied().filter(|to| reached.insert(*to)));
    }
    reached
}

fn shown(path: &ModulePath) -> String {
    if path.is_empty() { "(root)".to_owned() } else { path.join("::") }
}
