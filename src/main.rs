//! The command line of vorofit; see `vorofit --help`.

mod cli;

fn main() -> std::process::ExitCode {
    cli::main()
}
