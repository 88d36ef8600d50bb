"""elements draft"""
from __future__ import annotations
import numpy as np
from recorded import Firing, Recorded, EACH, Judge, stops_at, RAYS

def wrap(a): return np.mod(a+np.pi,2*np.pi)-np.pi
def sig(x): return 1/(1+np.exp(-np.clip(x,-30,30)))
def phi(x): return 1/(1+np.exp(-1.7*np.clip(x,-15,15)))

class Tracker:
    E=16
    def __init__(self, array, *, M=160, sigma=0.012, pd=0.9, soft=0.02, tau=2.5, vsd=0.015, q0=0.9, gate=1e-3, incidence=None, memory=6.0, plane=0.35, jit=0.003, seed=0, radii=(0.02,0.05,0.1), eps=0.2, gone=0.05, mut=0.03):
        self.a=array; self.half=array.half_angle; self.__dict__.update(M=M,sigma=sigma,pd=pd,soft=soft,tau=tau,vsd=vsd,q0=q0,gate=gate,incidence=incidence,memory=memory,plane=plane,jit=jit,radii=radii,eps=eps,gone=gone,mut=mut)
        E=self.E; z=lambda *s: np.zeros((E,M,*s))
        self.c=z(2); self.n=z(2); self.v=z(2); self.w=z(); self.rad=z(); self.flat=z()>0; self.lo=z(); self.hi=z()
        self.q=np.zeros(E); self.t=np.full(E,-1e9); self.rng=np.random.default_rng(seed); self.now=None
        self.mem=np.zeros((0,5)); self.births=0
    def move(self, t):
        dt=0.0 if self.now is None else t-self.now; self.now=t
        if dt<=0: return
        a=np.flatnonzero(self.q>0)
        if not len(a): return
        k=dt/self.tau
        self.v[a]=self.v[a]*(1-k)+self.vsd*np.sqrt(2*k)*self.rng.standard_normal((len(a),self.M,2))
        sp=np.hypot(self.v[a][...,0],self.v[a][...,1])[...,None]
        self.v[a]/=np.maximum(sp/0.03,1)
        self.c[a]+=dt*self.v[a]
    def predict(self, a, f):
        c=self.c[a]-f.apex; d=np.hypot(c[...,0],c[...,1]); flat=self.flat[a]; n=self.n[a]
        dp=-(n[...,0]*c[...,0]+n[...,1]*c[...,1])
        ang=np.where(flat,np.arctan2(-n[...,1],-n[...,0]),np.arctan2(c[...,1],c[...,0]))
        off=np.abs(wrap(ang-f.axis))
        s=-(-n[...,1]*c[...,0]+n[...,0]*c[...,1])  # tangential coordinate of the foot relative to c
        beyond=np.maximum(np.maximum(self.lo[a]-s,s-self.hi[a]),0)
        past=np.clip(off-self.half,0,1.2)
        pred=np.where(flat,dp/np.cos(past),d-self.rad[a])
        cin=sig((self.half-off)/self.soft)*np.where(flat,(beyond<=0.0)&(dp>0),1)
        wide=np.where(flat,0.39 if self.incidence is None else self.incidence,np.arcsin(np.clip(self.rad[a]/np.maximum(d,.01),0,1))*0.7)
        ein=sig((self.half+wide-off)/self.soft)*np.where(flat,(beyond<=0.12)&(dp>0),1)
        return np.maximum(pred,0.0),cin,ein,s
    def update(self, f):
        self.move(f.time); self.eye=f.apex
        S=self.sigma; a=np.flatnonzero(self.q>0); r=f.reading; owner=-1
        if len(a):
            pred,cin,ein,s=self.predict(a,f)
            if f.blind:
                like=phi((self.a.blind+0.01-pred)/S); free=np.zeros_like(pred)
            else:
                z=(r-pred)/S if not f.silent else (4.4-pred)/S
                like=np.exp(-0.5*z*z); free=phi(z-2.0)
            f_i=1-self.pd*cin*free
            if not f.silent and not f.known:
                L=(self.w[a]*ein*like).sum(1)
                best=int(np.argmax(L*self.q[a]))
                if L[best]>self.gate: owner=a[best]
            for i,e in enumerate(a):
                if e==owner:
                    g=ein[i]*like[i]+1e-4*f_i[i]
                    self.w[e]*=g; self.w[e]/=self.w[e].sum()
                    self.q[e]=1-(1-self.q[e])*0.5; self.t[e]=f.time
                    grow=self.flat[e]&(like[i]>0.3)
                    self.lo[e]=np.where(grow,np.minimum(self.lo[e],s[i]),self.lo[e]); self.hi[e]=np.where(grow,np.maximum(self.hi[e],s[i]),self.hi[e])
                elif not f.blind:
                    g=f_i[i]; tot=(self.w[e]*g).sum()
                    self.w[e]*=g; self.w[e]/=max(self.w[e].sum(),1e-12)
                    self.q[e]=self.q[e]*tot/(1-self.q[e]+self.q[e]*tot)
                    if self.q[e]<self.gone: self.q[e]=0
                if self.q[e]>0 and 1/np.sum(self.w[e]**2)<self.M/3: self.resample(e)
        if not f.silent and not f.known and owner<0: self.birth(f)
        if not f.blind: self.mem=np.vstack([self.mem,[*f.apex,f.axis,(4.4 if f.silent else r)-2*S,f.time]])
        self.mem=self.mem[self.mem[:,4]>f.time-self.memory]
    def resample(self, e):
        M=self.M; u=(np.arange(M)+self.rng.random())/M; i=np.minimum(np.searchsorted(np.cumsum(self.w[e]),u),M-1)
        for n in ("c","n","v","rad","flat","lo","hi"): getattr(self,n)[e]=getattr(self,n)[e][i]
        self.w[e]=1/M
        self.c[e]+=self.jit*self.rng.standard_normal((M,2))
        turn=0.02*self.rng.standard_normal(M); n=self.n[e]; self.n[e]=np.stack([n[:,0]-turn*n[:,1],n[:,1]+turn*n[:,0]],1); self.n[e]/=np.hypot(*self.n[e].T)[:,None]
        m=self.rng.random(M)<self.mut; new=self.rng.choice(self.radii,M); d=self.c[e]-self.eye; u=d/np.hypot(*d.T)[:,None]
        self.c[e]=np.where((m&~self.flat[e])[:,None],self.c[e]+(new-self.rad[e])[:,None]*u,self.c[e]); self.rad[e]=np.where(m,new,self.rad[e])
    def birth(self, f):
        e=int(np.argmin(self.q)) 
        if self.q[e]>0: e=int(np.argmin(self.t))
        M=self.M; self.births+=1
        r=f.reading+self.sigma*0.6*self.rng.standard_normal(M) if not f.blind else self.a.blind*self.rng.random(M)**0.5
        b=f.axis+self.half*self.rng.permutation(np.linspace(-1,1,M)); u=np.stack([np.cos(b),np.sin(b)],1)
        p=f.apex+r[:,None]*u
        self.flat[e]=self.rng.random(M)<self.plane; self.rad[e]=self.rng.choice(self.radii,M); self.n[e]=-u
        self.c[e]=np.where(self.flat[e][:,None],p,p+self.rad[e][:,None]*u)
        self.v[e]=self.vsd*self.rng.standard_normal((M,2)); self.lo[e]=0; self.hi[e]=0
        w=np.where(self.free(p,f.time),1e-4,1.0); self.w[e]=w/w.sum(); self.q[e]=self.q0; self.t[e]=f.time
        self.resample(e)
    def free(self, c, t):
        m=self.mem
        if not len(m): return np.zeros(len(c),bool)
        v=c[:,None,:]-m[None,:,:2]; rho=np.hypot(v[...,0],v[...,1]); slack=np.minimum(0.03*(t-m[:,4]),0.06)
        off=np.abs(wrap(np.arctan2(v[...,1],v[...,0])-m[:,2]))
        return ((np.sin(np.clip(self.half-0.03-off,-1.5,1.5))*rho>slack)&(rho<m[:,3]-slack)).sum(1)>=2
    def stops(self, here, hull, eps):
        a=np.flatnonzero(self.q>0)
        if not len(a): return np.full(len(RAYS),np.inf)
        flat=self.flat[a][...,None]; n=self.n[a]; c=self.c[a]
        disc=stops_at(here,c,hull+self.rad[a])
        t=np.stack([-n[...,1],n[...,0]],-1)
        ends=[stops_at(here,c+t*x[a][...,None],np.full(c.shape[:2],hull)) for x in (self.lo,self.hi)]
        d=((here-c)*n).sum(-1)[...,None]; nu=n@RAYS.T
        way=np.maximum((d-hull),0)/np.maximum(-nu,1e-6); s=((here-c)*t).sum(-1)[...,None]+way*(t@RAYS.T)
        face=np.where((nu<-1e-3)&(d>0)&(s>=self.lo[a][...,None])&(s<=self.hi[a][...,None]),way,np.inf)
        stop=np.where(flat,np.minimum(face,np.minimum(*ends)),disc)   # (E,M,D)
        order=np.argsort(stop,axis=1); st=np.take_along_axis(stop,order,1); w=np.take_along_axis(np.broadcast_to(self.w[a][...,None],stop.shape),order,1)
        cum=np.cumsum(w,axis=1)*self.q[a][:,None,None]
        st=np.where(cum>=eps,st,np.inf)
        return st.min(axis=(0,1))
    def covers(self, place):
        a=np.flatnonzero(self.q>0)
        if not len(a): return False
        c=place-self.c[a]; n=self.n[a]; t=np.stack([-n[...,1],n[...,0]],-1)
        s=np.clip((c*t).sum(-1),self.lo[a],self.hi[a]); seg=np.hypot(*np.moveaxis(c-t*s[...,None],-1,0))
        gap=np.where(self.flat[a],seg,np.hypot(c[...,0],c[...,1])-self.rad[a])
        return bool(((self.w[a]*(np.abs(gap)<0.1)).sum(1)*self.q[a]).max()>0.3)

def replay(r: Recorded, eps=(0.1,0.3,0.5), **kw):
    c=Tracker(r.array,**kw); js=[Judge(r) for _ in eps]
    for k,fs in enumerate(r.firings):
        for j in js: j.hear(fs)
        for f in fs: c.update(f)
        if k%EACH==0:
            for j,e in zip(js,eps): j.compare(k,c.stops(r.true[k],r.hull,e),c.covers)
    for j in js: j.n=c.births
    return js
