//! A worker process for the left hand's trials: `avr_trials VERB JOB`, with types of `tests::avr::trials`.
//! `avr_trials stack` prints the deepest stack in bytes.

use tests::avr::trials;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if arguments == ["stack"] {
        println!("{}", trials::stack().1);
        return Ok(());
    }
    let [verb, job] = arguments.as_slice() else { anyhow::bail!("usage: avr_trials VERB JOB") };
    let job: trials::Job = serde_json::from_str(job)?;
    let result = match verb.as_str() {
        "tilts" => serde_json::to_string(&trials::tilts(job))?,
        "tremor" => serde_json::to_string(&trials::tremor(job))?,
        "tilting" => serde_json::to_string(&trials::tilting(job))?,
        "bends" => serde_json::to_string(&trials::bends(job))?,
        other => anyhow::bail!("no verb {other}"),
    };
    println!("{result}");
    Ok(())
}
